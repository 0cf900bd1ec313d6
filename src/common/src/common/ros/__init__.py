"""The ROS edge that all nodes share: parameters, node life cycle, conversions, diagnostics, stage times."""
