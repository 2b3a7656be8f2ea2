"""The encoders of the flippers and a tracking system, for ``perception=lidar``.

In: the true state. Out: messages of ``flipperctl.core.lidar``.
"""

from __future__ import annotations

import numpy as np

from flipperctl.api import Instrument, RobotState
from flipperctl.core.lidar.messages import Joints, Pose
from flipperctl.sim.lidar.frames import heading, levelled


class Encoders(Instrument):
    """Measures the angles of the flippers."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Joints:
        """Return the true angles: encoders of geared joints err by far less than a policy feels."""
        return Joints(front=state.front, rear=state.rear)


class Tracking(Instrument):
    """Measures the pose of the robot without error."""

    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: RobotState, rng: np.random.Generator) -> Pose:
        """Return the true pose; frame M is the world, levelled if its z axis is not vertical."""
        level = levelled(state)
        x, z = state.position.tolist()
        x, y, z = (level @ [x, state.side, z]).tolist()
        return Pose(x=x, y=y, z=z, roll=state.roll, pitch=state.pitch, yaw=heading(state))
