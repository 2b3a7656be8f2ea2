"""A controller that holds the flippers level."""

from flipperctl.api import Controller, Perception, action_index, controller


@controller("level")
class Level(Controller):
    """Turn both flipper pairs to 0 rad and hold them there."""

    def act(self, p: Perception) -> int:
        """Return the action that turns both pairs one step towards 0, or holds them."""
        turns = [-round(angle / p.robot.angle_step) for angle in (p.front, p.rear)]
        return action_index(*(max(-1, min(1, turn)) for turn in turns))
