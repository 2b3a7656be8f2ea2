"""Actions drawn at random."""

from flipperctl.api import ACTIONS, Controller, Perception, controller


@controller("random")
class Random(Controller):
    """Every action equally likely; the floor that any policy must beat."""

    def act(self, p: Perception) -> int:
        """Draws from the episode's generator."""
        return int(p.rng.integers(len(ACTIONS)))
