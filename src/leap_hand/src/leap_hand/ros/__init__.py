"""The node leap_hand_node."""
