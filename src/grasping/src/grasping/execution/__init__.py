"""A requested grasp carried out: the state machine from the approach to the lifted object, and the watch on the hand
that tells whether it holds something. No ROS here.
"""
