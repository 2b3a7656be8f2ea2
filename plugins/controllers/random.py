"""A controller that draws its actions at random."""

from flipperctl.api import ACTIONS, Controller, Perception, controller


@controller("random")
class Random(Controller):
    """Draw every action with equal probability; a lower bound that any policy should beat."""

    def act(self, p: Perception) -> int:
        """Draw an action from the episode's generator."""
        return int(p.rng.integers(len(ACTIONS)))
