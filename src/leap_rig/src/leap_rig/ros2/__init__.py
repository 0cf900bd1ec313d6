"""The door to ROS 2, of two processes with a socket between them: `variables` (whom in the network ROS 2 hears), `wire`
(the frames of the socket), `channels` (what passes), `outbox` (what waits), `key_values` (messages that ROS 2 does not
know), `conversions` (bytes, in ROS 2's environment)."""
