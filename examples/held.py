"""A controller that learns its own number: one angle of the front pair.

Try it: ``flipperctl tune held terrain=step --plugins examples/held.py``
"""

import math

from pydantic import Field

from flipperctl.api import Controller, Perception, TrainingEpisodes, action_index, controller


@controller("held")
class Held(Controller):
    """Hold the front pair at one angle, the rear pair level."""

    front: float = Field(0.0, ge=-1, le=1, description="angle of the front pair [rad]")

    def act(self, p: Perception) -> int:
        off = self.front - p.front, -p.rear
        return action_index(*(max(-1, min(1, round(one / p.robot.angle_step))) for one in off))

    def learn(self, episodes: TrainingEpisodes) -> "Held":
        """Return the best of five angles, each played equally often."""
        rules = [self.model_copy(update={"front": step * math.pi / 12}) for step in range(-2, 3)]
        returns = [0.0] * len(rules)
        while episodes.left >= len(rules):
            for at, rule in enumerate(rules):
                returns[at] += episodes.play(rule.build()).rewards.sum()
        return rules[returns.index(max(returns))]
