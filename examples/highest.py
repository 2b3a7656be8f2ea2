"""A measure of your own: how high the robot climbs.

Try it: ``flipperctl eval okada terrain=step --plugins examples/highest.py``
"""

from collections.abc import Sequence

from flipperctl.api import Transition, measure


@measure("highest", unit="m", digits=3)
def highest(episode: Sequence[Transition]) -> float:
    """Largest height of the chassis centre in the world [m]."""
    return max(float(t.path[:, 1].max()) for t in episode)
