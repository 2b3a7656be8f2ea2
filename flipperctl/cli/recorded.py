"""The robot and the sensing with which a command reads a recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from flipperctl.api import Robot, Sensor


class RecordedRobot(NamedTuple):
    """What the overrides of a command say of a recorded robot."""

    sensor: Sensor
    robot: Robot
    pose: str | None
    """``perception.pose``; None: not given."""
    keys: frozenset[str]
    """The settings that were given."""


def recorded_robot(overrides: Sequence[str] | None) -> RecordedRobot:
    """Compose the robot and its LiDAR from the words of a command.

    Raises:
        ConfigError: a word is no override, or names no setting.
    """
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides

    parsed = Overrides.parse(["perception=lidar", *(overrides or ())])
    config = compose_environment(parsed)
    given = frozenset(Overrides.parse(overrides or ()).typed)
    pose = getattr(config.perception, "pose", None) if "perception.pose" in given else None
    return RecordedRobot(config.perception, config.robot, pose, given)
