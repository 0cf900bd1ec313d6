"""What feeds a record from the rig's topics, and the line that is shown meanwhile."""
