"""Bags of ROS 2 without ROS: ``episode`` writes one, ``ground`` makes recorded ground from one.

``messages`` has the frames and signs of ROS, ``reading`` opens what a robot has recorded, and
``transforms`` finds where a frame was at a time. All need the package ``rosbags`` (extra ``ros``).
"""
