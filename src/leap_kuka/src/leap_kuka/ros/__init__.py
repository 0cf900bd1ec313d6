"""The node leap_kuka_node."""
