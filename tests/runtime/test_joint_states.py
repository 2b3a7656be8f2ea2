"""Angles of the flippers from messages that hold a part of the joints each."""

import math

from flipperctl.runtime.messages import NewestJoints


def test_each_joint_counts_with_its_newest_angle_and_the_oldest_stamp():
    joints = NewestJoints(("a", "b"), ("c", "d"))
    assert joints.take(1.0, ["a", "b", "elbow"], [0.1, 0.3, 9.0]) is None
    assert joints.take(1.1, ["c"], [0.5]) is None
    found = joints.take(1.2, ["d"], [0.7])
    assert (found.time, found.front, found.rear) == (1.0, 0.2, 0.6)
    assert joints.take(1.3, ["elbow"], [9.0]) is None
    found = joints.take(1.4, ["b", "a"], [0.5])  # a joint without a position is none
    assert (found.time, found.front) == (1.0, 0.3)
    found = joints.take(math.nan, ["b"], [0.5])
    assert math.isnan(found.time)  # without a stamp, which the intake refuses
