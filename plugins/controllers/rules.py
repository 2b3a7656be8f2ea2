"""Rules that need no training: baselines, and one that follows the terrain."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import (
    ACTIONS,
    Controller,
    Perception,
    action_index,
    candidate_angle,
    controller,
)

from ..posture import with_masses
from ..resting import rest


@controller("level")
class Level(Controller):
    """Turn both flipper pairs to 0 rad and hold them there."""

    def act(self, p: Perception) -> int:
        """Return the action that turns both pairs one step towards 0, or holds them."""
        return towards(p, 0.0, 0.0)


@controller("random")
class Random(Controller):
    """Draw every action with equal probability; a lower bound that any policy should beat."""

    def act(self, p: Perception) -> int:
        """Draw an action from the episode's generator."""
        return int(p.rng.integers(len(ACTIONS)))


@controller("okada")
class Okada(Controller):
    """Turn the front flippers along the ground ahead; the rear ones are held level.

    Okada et al. (Journal of Field Robotics 28(6), 2011) lay the flippers along the scanned
    terrain. Here a pair takes the largest angle to the inflated terrain, the rear pair
    ``rear_gain`` of it. They exclude angles at which the robot would stand with too small a
    normalised energy stability margin. With ``margin``, the turns come as near to the angles as
    the margin allows, where the robot would rest by contact geometry.
    """

    near: float = Field(
        0.1,
        ge=0,
        le=1,
        description="distance from the hinge at which the considered terrain begins [m]",
    )
    far: float = Field(
        0.45,
        gt=0,
        le=3,
        description="distance from the hinge at which the considered terrain ends [m]",
    )
    rear_gain: float = Field(
        0.0,
        ge=-2,
        le=2,
        description="rear flipper angle as a fraction of the terrain angle behind the robot: 1 "
        "lays the rear pair along the terrain, 0 holds it level with the chassis, as is the "
        "smoothest for okada [-]",
    )

    margin: float | None = Field(
        None,
        ge=0,
        le=0.5,
        description="smallest normalised energy stability margin after a turn, here and a "
        "decision ahead; null: none [m]",
    )

    @model_validator(mode="after")
    def _near_is_below_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near={self.near:g} must be below far={self.far:g}")
        return self

    def act(self, p: Perception) -> int | tuple[float, ...]:
        """Turn each pair one step towards its target; hold it within half an angle step of it."""
        front, rear = self.angle(p, rear=False), self.rear_gain * self.angle(p, rear=True)
        if self.margin is not None:
            return self._stable(p, self.margin, front, rear)
        return towards(p, front, rear)

    def _stable(self, p: Perception, least: float, front: float, rear: float) -> int:
        """Return the turns closest to the targets that keep the margin, or lack least of it."""
        robot, limit = with_masses(p.robot), p.robot.angle_limit
        # How the robot would rest with each pair of turns, here and a decision ahead
        turns = robot.angle_step * np.array([-1.0, 0.0, 1.0])
        angles = [np.clip(angle + turns, -limit, limit) for angle in (p.front, p.rear)]
        places = np.array([0.0, robot.track_speed * robot.decision_period])
        margin = rest(p.points, robot, places, *angles).margin.min(axis=0)  # (3, 3) [m]
        away = np.abs(angles[0] - front)[:, None] + np.abs(angles[1] - rear)
        # Turns that lack margin cost more than any that have it.
        lacking = np.maximum(0.0, least - margin)
        best = int(np.where(lacking > 0, 1e3 * (1 + lacking), away).argmin())
        return action_index(best // 3 - 1, best % 3 - 1)

    def angle(self, p: Perception, *, rear: bool) -> float:
        """Return the angle along the ground ahead, or behind for ``rear``, in frame R [rad]."""
        return candidate_angle(p.points, p.pitch, p.robot, near=self.near, far=self.far, rear=rear)


@controller("okada_published")
class OkadaPublished(Okada):
    """``okada`` with the rear gain of version 0.2, with which its results were published."""

    rear_gain: float = Field(
        0.5, ge=-2, le=2, description=Okada.model_fields["rear_gain"].description
    )


@controller("ohno")
class Ohno(Okada):
    """Lay both pairs on the ground as if the chassis lay along the ground below it.

    Ohno et al. (IROS 2007) and Nagatani et al. (IROS 2008) let the flippers follow the ground that
    sensors see, and the chassis the plane of that ground, so that all tracks keep contact. Here
    the pitch of that plane is the slope of the least-squares line through the points from ``far``
    behind the rear hinge to ``far`` ahead of the front one. The angles to the ground count from
    it, not from the sensed pitch: a chassis that stands steeper pushes its rear pair down.
    """

    rear_gain: float = Field(
        1.0, ge=-2, le=2, description=Okada.model_fields["rear_gain"].description
    )

    def angle(self, p: Perception, *, rear: bool) -> float:
        """Return the angle to the ground from the plane of the ground [rad]."""
        x, z = p.points[np.abs(p.points[:, 0]) <= p.robot.hinge_offset + self.far].T
        # The slope of the least-squares line
        spread = x - x.mean() if x.size else x
        plane = math.atan2(float(spread @ z), max(float(spread @ spread), 1e-9))
        return super().angle(replace(p, pitch=plane), rear=rear)


@controller("linear")
class Linear(Controller):
    """Turn each pair to a linear function of the pitch and of one height of the ground.

    Pecka, Zimmermann and Svoboda (IROS 2016) search such numbers by policy search with safety
    constraints. Here the height belongs to the highest point within a track radius of the tip of
    level front flippers. It counts from the ground on which a level robot stands. The defaults are
    the result of ``flipperctl tune`` on the ten families.
    """

    front: float = Field(0.0, ge=-2, le=2, description="ω₁, constant of the front pair [rad]")
    front_pitch: float = Field(-1.3, ge=-4, le=4, description="ω₂, front angle per pitch [-]")
    front_height: float = Field(
        2.5, ge=-10, le=10, description="ω₃, front angle per height of the ground [rad/m]"
    )
    rear: float = Field(-0.05, ge=-2, le=2, description="ω₄, constant of the rear pair [rad]")
    rear_pitch: float = Field(-0.57, ge=-4, le=4, description="ω₅, rear angle per pitch [-]")
    rear_height: float = Field(
        1.06, ge=-10, le=10, description="ω₆, rear angle per height of the ground [rad/m]"
    )

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards its target; hold it within half an angle step of it."""
        robot, height = p.robot, 0.0
        tip = robot.hinge_offset + robot.flipper_axle + robot.track_radius
        # Without ground there, the robot counts as standing on level ground.
        near = np.abs(p.points[:, 0] - tip) <= robot.track_radius
        if near.any():
            height = float(p.points[near, 1].max()) + robot.track_radius
        return towards(
            p,
            robot.clip(self.front + self.front_pitch * p.pitch + self.front_height * height),
            robot.clip(self.rear + self.rear_pitch * p.pitch + self.rear_height * height),
        )


def towards(p: Perception, front: float, rear: float) -> int:
    """Return the action that turns each pair one step towards its target [rad].

    A pair within half an angle step of it is held.
    """
    return action_index(*turns_to((front, rear), (p.front, p.rear), p.robot.angle_step))


def turns_to(targets: Sequence[float], angles: Sequence[float], step: float) -> list[int]:
    """Return the turn of each joint, one ``step`` towards its target, or none within half of it.

    ``targets`` and measured ``angles`` are of J joints, as ``step`` in rad.
    """
    turns = (round((target - angle) / step) for target, angle in zip(targets, angles, strict=True))
    return [max(-1, min(1, turn)) for turn in turns]
