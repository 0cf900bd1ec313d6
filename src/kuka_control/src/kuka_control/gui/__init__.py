"""The control panel: what it shows (`panel_state`) and the Qt widget that shows it (`panel`); no ROS here."""
