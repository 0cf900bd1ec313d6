"""The door to LeRobot's own programs: protocol, actions, and the server; its other end is in integrations/."""
