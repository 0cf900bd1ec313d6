"""Windows without ROS: the control panel (`panel_state`, `panel`), drawings of the workspace (`plot`, `plot_scene`)."""
