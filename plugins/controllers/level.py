"""Flippers held flat."""

from flipperctl.api import Controller, Perception, action_index, controller


@controller("level")
class Level(Controller):
    """Brings both flipper pairs to 0 and holds them there."""

    def act(self, p: Perception) -> int:
        """Towards zero, by whole angle steps."""
        turns = [-round(angle / p.robot.angle_step) for angle in (p.front, p.rear)]
        return action_index(*(max(-1, min(1, turn)) for turn in turns))
