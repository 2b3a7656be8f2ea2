"""A bag of a robot that drives towards a step, with all that its devices measure."""

import numpy as np

from flipperctl.api import RobotState
from flipperctl.core.lidar.body import mounting
from flipperctl.ros.episode import Stamped
from flipperctl.ros.messages import LIDAR, Messages

SPEED, SECONDS, EDGE, HEIGHT = 0.25, 1.8, 1.21, 0.15
"""Speed [m/s], length [s], place of the step ahead of the start [m], and its height [m]."""
MOUNT, AXIS = np.array([0.25, 0.0, 0.4]), -0.8
FRONT, REAR = 0.2, 0.1
"""Angles of the flippers [rad]."""


def state(time):
    """The robot drives ahead on level ground."""
    return RobotState(
        np.array([SPEED * time, 0.1]), 0.0, FRONT, REAR, np.array([SPEED, 0.0]), 0.0, time
    )


def points(time):
    """The ground from 0.4 to 1.9 m ahead of the chassis, (P, 3) in the frame of the LiDAR."""
    ahead, left = np.meshgrid(np.arange(0.4, 1.9, 0.012), np.arange(-0.4, 0.41, 0.1))
    x = ahead.ravel()
    z = np.where(x + SPEED * time > EDGE, HEIGHT, 0.0) - 0.1
    up, beside = np.meshgrid(np.arange(0.0, HEIGHT, 0.01), left[:, 0])
    edge = np.full(up.size, EDGE - SPEED * time)
    riser = np.column_stack([edge, beside.ravel(), up.ravel() - 0.1])
    level = np.column_stack([x, left.ravel(), z])
    return (np.concatenate([level, riser]) - MOUNT) @ mounting(AXIS)


def driving(clouds=True):
    """Yield the messages; 10 clouds a second, everything else 20 times."""
    make = Messages()
    yield Stamped(0.0, "/tf_static", make.mount(MOUNT[0], MOUNT[2], AXIS))
    for tick in range(round(20 * SECONDS) + 1):
        time = tick / 20
        here = state(time)
        yield Stamped(time, "/tf", make.transforms(here))
        yield Stamped(time, "/imu/data", make.imu(time, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        yield Stamped(time, "/joint_states", make.joint_state(time, FRONT, REAR))
        yield Stamped(time, "/belt_speed", make.number(SPEED))
        if clouds and tick % 2 == 0:
            yield Stamped(time, "/points", make.cloud(time, LIDAR, points(time)))
