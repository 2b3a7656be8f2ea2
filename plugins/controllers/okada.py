"""A terrain-following rule after Okada et al. 2011."""

from typing import Self

from pydantic import Field, model_validator

from flipperctl.api import Controller, Perception, action_index, candidate_angle, controller


@controller("okada")
class Okada(Controller):
    """Turn front flippers along the ground ahead and rear flippers along the ground behind.

    Okada et al. (Journal of Field Robotics 28(6), 2011) lay the flippers along the scanned
    terrain. Here each pair takes the largest angle to the inflated terrain.
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
        0.5,
        ge=-2,
        le=2,
        description="rear flipper angle as a fraction of the terrain angle behind the robot; "
        "below 1 the rear flippers press the tail up while the chassis climbs [-]",
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
        turns = [
            round((target - angle) / p.robot.angle_step)
            for target, angle in zip((front, self.rear_gain * rear), (p.front, p.rear), strict=True)
        ]
        return action_index(*(max(-1, min(1, turn)) for turn in turns))
