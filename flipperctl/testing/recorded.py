"""Episodes of every outcome, played once by simple rules and kept.

They need no registered plugin. Out: scenes, and the transitions of an episode on each.
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
    LAST_PITCHES,
    Outcome,
    Perception,
    Profile,
    RewardTerm,
    Terrain,
    Transition,
    Transitions,
    action_index,
    candidate_angle,
)
from flipperctl.config import EnvConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.plugin import FunctionPolicy
from flipperctl.rollout.episode import decisions

HOLD = action_index(0, 0)


class Ground(Terrain):
    """A terrain of given points."""

    plugin_name: ClassVar[str] = "recorded"
    points: tuple[tuple[float, float], ...] = Field(((0.0, 0.0),), description="points (x, z) [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the profile of the points."""
        return Profile(self.points)


class NoReward(RewardTerm):
    """A reward that is always 0, for checks of other plugins."""

    plugin_name: ClassVar[str] = "no_reward"

    def __call__(self, t: Transition) -> float:
        """Return 0."""
        return 0.0


def hold(p: Perception) -> int:
    """Return the action that holds both flipper pairs."""
    return HOLD


def follow(p: Perception) -> int:
    """Return the action that turns front flippers to the candidate angle and rear ones level."""
    wanted = (candidate_angle(p.points, p.pitch, p.robot) - p.front, -p.rear)
    return action_index(*(max(-1, min(1, round(w / p.robot.angle_step))) for w in wanted))


def draw_action(p: Perception) -> int:
    """Draw any action with equal probability."""
    return int(p.rng.integers(len(ACTIONS)))


@dataclass(frozen=True)
class Scene:
    """Ground, environment settings, a rule, and the outcome of that rule's episode."""

    points: tuple[tuple[float, float], ...]
    rule: Callable[[Perception], int]
    outcome: Outcome
    settings: dict[str, Any] = field(default_factory=dict)

    def environment(self) -> FlipperEnv:
        """Return the environment on this ground."""
        own = {"terrain": Ground(points=self.points), "rewards": {"none": NoReward()}}
        return FlipperEnv(config=parse(EnvConfig, {**own, **self.settings}))

    @property
    def policy(self) -> FunctionPolicy:
        """The rule as a policy."""
        return FunctionPolicy(self.rule)


_STEPS = ((0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0))
_POOR_SENSING = {"perception": {"noise": 0.03, "dropout": 0.7, "horizon": 0.4, "angle_noise": 0.02}}
_WALL = ((0.0, 0.0), (0.0, 1.0))
_SMOOTH = {"sim": {"friction": 0.3}}  # with more, the tracks climb the wall and the robot overturns
SCENES = (
    Scene(_STEPS, follow, Outcome.REACHED),
    Scene(((0.0, 0.0), (0.5, 0.05), (1.0, 0.0)), draw_action, Outcome.REACHED, _POOR_SENSING),
    Scene(((0.0, 0.0), (0.0, -1.0)), hold, Outcome.OVERTURNED),
    Scene(_WALL, follow, Outcome.STUCK, _SMOOTH),
    Scene(_WALL, draw_action, Outcome.TIMEOUT, {"episode": {"slack": 1.01}, **_SMOOTH}),
)
"""Two steps, a bump with poor sensing, a ledge, a smooth wall, and the wall with little time."""

SHORT = Scene(
    ((0.0, 0.0), (0.1, 0.0)), hold, Outcome.REACHED, {"episode": {"run_up": 0.2, "run_out": 0.2}}
)
"""Half a metre of level ground, for controllers that search the scene before the episode."""


@cache
def transitions() -> tuple[Transition, ...]:
    """Return all transitions of an episode on each scene; together they have all four outcomes.

    Raises:
        RuntimeError: an episode did not end with its scene's outcome.
    """
    found: list[Transition] = []
    for index, scene in enumerate(SCENES):
        episode = [d.transition for d in decisions(scene.environment(), scene.policy, index)]
        if episode[-1].outcome is not scene.outcome:
            raise RuntimeError(
                f"recorded scene {index} ended as {episode[-1].outcome}, not {scene.outcome}"
            )
        found += episode
    return tuple(found)


@cache
def transitions_in_arrays() -> tuple[Transitions, ...]:
    """Return all transitions in arrays, those with few last pitches apart."""
    groups: dict[object, list[Transition]] = {}
    for t in transitions():
        pitches = min(len(t.pitches), LAST_PITCHES)
        groups.setdefault((id(t.profile), t.path.shape, pitches), []).append(t)
    return tuple(Transitions.of(group) for group in groups.values())
