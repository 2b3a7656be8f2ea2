"""Rules that need no training: baselines, and one that follows the terrain."""

from typing import Self

from pydantic import Field, model_validator

from flipperctl.api import (
    ACTIONS,
    Controller,
    Perception,
    action_index,
    candidate_angle,
    controller,
)


@controller("level")
class Level(Controller):
    """Turn both flipper pairs to 0 rad and hold them there."""

    def act(self, p: Perception) -> int:
        """Return the action that turns both pairs one step towards 0, or holds them."""
        return _towards(p, 0.0, 0.0)


@controller("random")
class Random(Controller):
    """Draw every action with equal probability; a lower bound that any policy should beat."""

    def act(self, p: Perception) -> int:
        """Draw an action from the episode's generator."""
        return int(p.rng.integers(len(ACTIONS)))


@controller("okada")
class Okada(Controller):
    """Turn the front flippers along the ground ahead, the rear ones along that behind.

    Okada et al. (Journal of Field Robotics 28(6), 2011) lay the flippers along the scanned
    terrain. Here each pair takes the largest angle to the inflated terrain, the rear pair a
    fraction of it.
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
        "lays the rear pair along the terrain, 0 holds it level with the chassis, which is the "
        "smoothest [-]",
    )

    @model_validator(mode="after")
    def _near_is_below_far(self) -> Self:
        if self.near >= self.far:
            raise ValueError(f"near={self.near:g} must be below far={self.far:g}")
        return self

    def act(self, p: Perception) -> int:
        """Turn each pair one step towards its target; hold it within half an angle step of it."""
        front, rear = (
            candidate_angle(p.points, p.pitch, p.robot, near=self.near, far=self.far, rear=behind)
            for behind in (False, True)
        )
        return _towards(p, front, self.rear_gain * rear)


@controller("okada_published")
class OkadaPublished(Okada):
    """``okada`` with the rear gain of version 0.2, with which its results were published."""

    rear_gain: float = Field(
        0.5, ge=-2, le=2, description=Okada.model_fields["rear_gain"].description
    )


def _towards(p: Perception, front: float, rear: float) -> int:
    """Return the action that turns each pair one step towards its target [rad].

    A pair within half an angle step of it is held.
    """
    turns = (
        round((target - angle) / p.robot.angle_step)
        for target, angle in ((front, p.front), (rear, p.rear))
    )
    return action_index(*(max(-1, min(1, turn)) for turn in turns))
