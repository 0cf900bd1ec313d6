"""What every package of the rig shares. Geometry: `rotations`, `poses`, `camera_model`, `plane_fit`, `mounting`,
`frames`. Words between nodes: `modes`, `reasons`, `teleop_record`, `operator_rows`, `robot_hand`. Programs: `config`
(typed yaml), `command_line`, `clock`, `errors`. Tracking: `hand_tracking`, `hand_delay`, `input_watch`. `ros`: life of
a node, parameters, services, messages."""
