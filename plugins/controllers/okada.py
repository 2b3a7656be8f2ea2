"""A terrain-following rule after Okada et al. 2011."""

from pydantic import Field

from flipperctl.api import Controller, Perception, action_index, candidate_angle, controller


@controller("okada")
class Okada(Controller):
    """Front flippers at the candidate angle, rear flippers on the terrain behind.

    Okada et al. (Journal of Field Robotics 28(6), 2011) lay the flippers along the terrain that
    was scanned; both pairs do so here, each with the largest angle to the inflated terrain.
    """

    near: float = Field(0.1, ge=0, le=1, description="nearest terrain, from the hinge [m]")
    far: float = Field(0.45, gt=0, le=3, description="farthest terrain, from the hinge [m]")
    rear_gain: float = Field(
        0.5,
        ge=-2,
        le=2,
        description="share of the terrain angle behind that the rear flippers take; below 1 they "
        "press the tail up while the chassis climbs [-]",
    )

    def act(self, p: Perception) -> int:
        """One step towards both target angles; nothing within half an angle step."""
        front, rear = (
            candidate_angle(p.points, p.pitch, p.robot, near=self.near, far=self.far, rear=behind)
            for behind in (False, True)
        )
        turns = [
            round((target - angle) / p.robot.angle_step)
            for target, angle in zip((front, self.rear_gain * rear), (p.front, p.rear), strict=True)
        ]
        return action_index(*(max(-1, min(1, turn)) for turn in turns))
