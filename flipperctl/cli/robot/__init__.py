"""``flipperctl robot``: what a robot recorded, and the signs of its devices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flipperctl.config import EnvConfig

HELP = "Check a robot's sensing and signs, and use what it recorded."
VIEWS = ("check", "shadow", "ground", "self-test")
"""Modules beside this one, each with a subcommand; help lists them in this order."""


def recorded_robot(
    overrides: Sequence[str] | None,
) -> tuple[EnvConfig, str | None, frozenset[str]]:
    """Return the robot and LiDAR of a recording, ``perception.pose`` and the settings given.

    ``perception.pose`` is None if it is not among these.
    """
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides

    words = list(overrides or ())
    config = compose_environment(Overrides.parse(["perception=lidar", *words]))
    given = frozenset(Overrides.parse(words).typed)
    pose = getattr(config.perception, "pose", None) if "perception.pose" in given else None
    return config, pose, given
