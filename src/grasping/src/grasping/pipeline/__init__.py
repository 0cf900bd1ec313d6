"""From grasp maps to grasps in space: the view of the scene, maxima, projection, limits, tracking and the choice among
them. Offline use is the stateless case of the same steps; no ROS here.
"""
