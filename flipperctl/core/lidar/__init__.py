"""Perception by LiDAR as a robot's computer runs it: self-filter, odometry, map, estimates.

In: messages of the devices. Out: the sensed ground and posture. It needs numpy alone,
but for ``matching``, which a robot may leave out and which needs small_gicp.

Frame S is the LiDAR's, whose z axis is the axis of its rings. Frame R is fixed to the chassis (x
forward, y to the left, z up, origin at its centre). Frame M is the map's, level, in which the robot
starts. Frame L has its origin at the chassis centre, is level and follows the heading.
"""
