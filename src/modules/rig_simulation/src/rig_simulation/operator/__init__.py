"""The simulated operator: hand motions above the Leap Motion controller, and the scenarios that grasp objects step by
step with what the rig publishes."""
