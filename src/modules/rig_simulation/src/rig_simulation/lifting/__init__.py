"""Lifting things in MuJoCo with the rig's hand, to judge grasps that others chose."""
