"""The signs of a robot's angles and axes, and how they become those of flipperctl.

In: numbers in the robot's convention. Out: the same in that of flipperctl, and back.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from flipperctl.errors import PolicyError


@dataclass(frozen=True)
class Signs:
    """1 where the robot's convention agrees with flipperctl's, -1 where it is opposite."""

    front: int = 1
    """Of the front flippers' angle: flipperctl's grows when they are raised."""
    rear: int = 1
    """Of the rear flippers' angle: flipperctl's grows when they are raised."""
    pitch: int = 1
    """Of the pitch: flipperctl's grows when the nose is lifted."""
    yaw: int = 1
    """Of the yaw rate: flipperctl's is positive to the left."""
    x: int = 1
    """Of the x axis of clouds and odometry: flipperctl's points ahead. -1 turns clouds by π."""

    def __post_init__(self) -> None:
        """Refuse other factors."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value not in (1, -1) or isinstance(value, bool):
                raise PolicyError(f"signs.{field.name} is {value!r}; 1 or -1 is allowed")


OURS = Signs()
"""The robot measures as flipperctl does."""
REP_103 = Signs(front=-1, pitch=-1)
"""Rotations about +y, to the left: front flipper down, rear flipper up and nose down positive."""
CONVENTIONS = {"flipperctl": OURS, "rep103": REP_103}
"""The named conventions."""
