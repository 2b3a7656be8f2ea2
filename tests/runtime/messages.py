"""What a robot at rest on level ground sends, its setup, and a drive by such messages."""

import math

import numpy as np

from flipperctl.runtime import (
    Ages,
    Attitude,
    Cloud,
    FlipperController,
    JointAngles,
    Limits,
    Mount,
    Odometry,
    RobotSetup,
)

RELAXED = Limits(ages=Ages(joints=0.2))  # the simulated encoders report with each scan
LEVEL = np.stack(np.meshgrid(np.linspace(-1, 2, 61), np.linspace(-0.5, 0.5, 11)), -1).reshape(-1, 2)
GROUND = np.column_stack([LEVEL, np.full(len(LEVEL), -0.1)])
IN_CHASSIS = RobotSetup(cloud_frame="base_link", mount=Mount(0.0, 0.0, math.pi / 2, 0.0, 0.05))
"""Clouds come in the frame of the chassis."""


def good(now: float, **changes: object) -> dict[str, object]:
    """Messages of a robot at rest on level ground; what is measured is never quite the same."""
    noise = 1e-6 * math.sin(97 * now)
    return {
        "cloud": Cloud(now, "base_link", GROUND + noise),
        "attitude": Attitude(now, "base_link", noise, noise, 0.0),
        "joints": JointAngles(now, 0.1, 0.2),
        "odometry": Odometry(now, 0.2),
        **changes,
    }


def drive(controller: FlipperController, until: float = 1.0) -> float:
    """Let it drive on level ground; return the time of the last step."""
    for i in range(round(until / 0.05) + 1):
        answer = controller.step(0.05 * i, **good(0.05 * i))
        assert answer.state == "driving", answer
    return 0.05 * i
