"""Windows without ROS: the control panel (`panel_state`, `panel`) and the drawings of the workspace (`plot`)."""
