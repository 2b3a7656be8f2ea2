"""Real episodes of every outcome, played once by rules of this module's own.

They need no registered plugin. Out: scenes, and the transitions recorded on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import (
    ACTIONS,
    Outcome,
    Perception,
    Profile,
    RewardTerm,
    Terrain,
    Transition,
    action_index,
    candidate_angle,
)
from flipperctl.config import EnvConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.function import FunctionPolicy
from flipperctl.rollout.episode import decisions

HOLD = action_index(0, 0)


class Ground(Terrain):
    """The points that it is given."""

    plugin_name: ClassVar[str] = "recorded"
    points: tuple[tuple[float, float], ...] = Field(((0.0, 0.0),), description="(x, z) [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Always the same."""
        return Profile(self.points)


class NoReward(RewardTerm):
    """Pays nothing, for those who only drive."""

    plugin_name: ClassVar[str] = "no_reward"

    def __call__(self, t: Transition) -> float:
        """Return 0."""
        return 0.0


def hold(p: Perception) -> int:
    """Leave the flippers as they are."""
    return HOLD


def follow(p: Perception) -> int:
    """Lay the front flippers along the terrain ahead; the rear ones stay level."""
    wanted = (candidate_angle(p.points, p.pitch, p.robot) - p.front, -p.rear)
    return action_index(*(max(-1, min(1, round(w / p.robot.angle_step))) for w in wanted))


def anything(p: Perception) -> int:
    """Any action."""
    return int(p.rng.integers(len(ACTIONS)))


@dataclass(frozen=True)
class Scene:
    """Ground, settings, and a rule that comes to a known end there."""

    points: tuple[tuple[float, float], ...]
    rule: Callable[[Perception], int]
    outcome: Outcome
    settings: dict[str, Any] = field(default_factory=dict)

    def environment(self) -> FlipperEnv:
        """Return the environment on this ground."""
        chosen = {"terrain": Ground(points=self.points), "rewards": {"none": NoReward()}}
        return FlipperEnv(config=parse(EnvConfig, {**chosen, **self.settings}))

    @property
    def policy(self) -> FunctionPolicy:
        """The rule as a policy."""
        return FunctionPolicy(self.rule)


_STEPS = ((0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0))
_SEEN_BADLY = {"perception": {"noise": 0.03, "dropout": 0.7, "horizon": 0.4, "angle_noise": 0.02}}
_WALL = ((0.0, 0.0), (0.0, 1.0))
_SMOOTH = {"sim": {"friction": 0.3}}  # else the belts climb the wall until the robot turns over
SCENES = (
    Scene(_STEPS, follow, Outcome.REACHED),
    Scene(((0.0, 0.0), (0.5, 0.05), (1.0, 0.0)), anything, Outcome.REACHED, _SEEN_BADLY),
    Scene(((0.0, 0.0), (0.0, -1.0)), hold, Outcome.OVERTURNED),
    Scene(_WALL, follow, Outcome.STUCK, _SMOOTH),
    Scene(_WALL, anything, Outcome.TIMEOUT, {"episode": {"slack": 1.01}, **_SMOOTH}),
)
"""Up and down a step, a bump seen badly, a ledge, a smooth wall, and it again with little time."""

SHORT = Scene(
    ((0.0, 0.0), (0.1, 0.0)), hold, Outcome.REACHED, {"episode": {"run_up": 0.2, "run_out": 0.2}}
)
"""Half a metre of level ground, for controllers that search the scene first."""


@cache
def transitions() -> tuple[Transition, ...]:
    """Every decision of an episode on each scene, the last ones with all four outcomes.

    Raises:
        RuntimeError: an episode did not end as its scene says.
    """
    found: list[Transition] = []
    for index, scene in enumerate(SCENES):
        seen = [d.transition for d in decisions(scene.environment(), scene.policy, index)]
        if seen[-1].outcome is not scene.outcome:
            raise RuntimeError(
                f"recorded scene {index} ended as {seen[-1].outcome}, not {scene.outcome}"
            )
        found += seen
    return tuple(found)
