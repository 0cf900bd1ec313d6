"""The campaign: faults on the running rig, judged at the robot's side of the wire; and the rig over hours."""
