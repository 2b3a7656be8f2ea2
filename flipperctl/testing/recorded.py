"""Episodes of every outcome, and the checks of reward terms, measures and loggers on them.

The episodes are played once, by simple rules that need no registered plugin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import pairwise
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import (
    ACTIONS,
    LAST_PITCHES,
    Logger,
    Measure,
    Outcome,
    Perception,
    Profile,
    RewardTerm,
    RunInfo,
    Terrain,
    Transition,
    Transitions,
    action_index,
    candidate_angle,
)
from flipperctl.config import EnvConfig, parse
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.metrics import applies, heading, measures
from flipperctl.policies.controllers import FunctionPolicy
from flipperctl.rollout.episode import decisions
from flipperctl.testing.check import NotChecked, of, require

HOLD = action_index(0, 0)
_ROUNDING = 1e-9
_ROW: dict[str, Any] = {
    "episode": 1,
    "seed": 7,
    "terrain": "flat",
    "outcome": Outcome.REACHED,
    "success_rate": 1.0,
    "return": -2.5,
    "loss": None,
}


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


def _hold(p: Perception) -> int:
    return HOLD


def _follow(p: Perception) -> int:
    """Return the action that turns front flippers to the candidate angle and rear ones level."""
    wanted = (candidate_angle(p.points, p.pitch, p.robot) - p.front, -p.rear)
    return action_index(*(max(-1, min(1, round(w / p.robot.angle_step))) for w in wanted))


def _draw_action(p: Perception) -> int:
    return int(p.rng.integers(len(ACTIONS)))


@dataclass(frozen=True)
class Scene:
    """Ground, a rule, the outcome of that rule's episode, and settings of the environment."""

    points: tuple[tuple[float, float], ...]
    rule: Callable[[Perception], int]
    outcome: Outcome
    settings: dict[str, Any] = field(default_factory=dict)

    def environment(self) -> FlipperEnv:
        """Return the environment on this ground."""
        scene = {"terrain": Ground(points=self.points), "rewards": {"none": NoReward()}}
        return FlipperEnv(config=parse(EnvConfig, {**scene, **self.settings}))

    @property
    def policy(self) -> FunctionPolicy:
        """The rule as a policy."""
        return FunctionPolicy(self.rule)


_STEPS = ((0.0, 0.0), (0.0, 0.2), (1.0, 0.2), (1.0, 0.0))
_POOR_SENSING = {"perception": {"noise": 0.03, "dropout": 0.7, "horizon": 0.4, "angle_noise": 0.02}}
_WALL = ((0.0, 0.0), (0.0, 1.0))
_SMOOTH = {"sim": {"friction": 0.3}}  # with more, the tracks climb the wall and the robot overturns
SCENES = (
    Scene(_STEPS, _follow, Outcome.REACHED),
    Scene(((0.0, 0.0), (0.5, 0.05), (1.0, 0.0)), _draw_action, Outcome.REACHED, _POOR_SENSING),
    Scene(((0.0, 0.0), (0.0, -1.0)), _hold, Outcome.OVERTURNED),
    Scene(_WALL, _follow, Outcome.STUCK, _SMOOTH),
    Scene(_WALL, _draw_action, Outcome.TIMEOUT, {"episode": {"slack": 1.01}, **_SMOOTH}),
)
"""Two steps, a bump with poor sensing, a ledge, a smooth wall, and the wall with little time."""

SHORT = Scene(
    ((0.0, 0.0), (0.1, 0.0)), _hold, Outcome.REACHED, {"episode": {"run_up": 0.2, "run_out": 0.2}}
)
"""Half a metre of level ground, for controllers that search the scene before the episode."""


@cache
def transitions() -> tuple[Transition, ...]:
    """Return all transitions of an episode on each scene; together they have all four outcomes."""
    result: list[Transition] = []
    for index, scene in enumerate(SCENES):
        result += [d.transition for d in decisions(scene.environment(), scene.policy, index)]
        if result[-1].outcome is not scene.outcome:
            raise RuntimeError(
                f"recorded scene {index} ended as {result[-1].outcome}, not {scene.outcome}"
            )
    return tuple(result)


@cache
def transitions_in_arrays() -> tuple[Transitions, ...]:
    """Return all transitions in arrays; transitions with few last pitches are in others."""
    # Arrays hold transitions of one ground and equal shapes alone.
    groups: dict[object, list[Transition]] = {}
    for t in transitions():
        pitches = min(len(t.pitches), LAST_PITCHES)
        groups.setdefault((id(t.profile), t.path.shape, pitches), []).append(t)
    return tuple(Transitions.of(group) for group in groups.values())


@of("reward", "finite")
def finite(reward: RewardTerm) -> None:
    """Check that the reward of every transition is a finite float."""
    for t in transitions():
        value = reward(t)
        require(
            isinstance(value, float) and math.isfinite(value),
            f"{_at(t)} it returns {value!r}; it must return a finite float",
        )


@of("reward", "bounded")
def bounded(reward: RewardTerm) -> None:
    """Check that every reward lies within ``bounds``."""
    # Rounding may carry a value just past a bound.
    low, high = reward.bounds
    require(low <= high, f"bounds are {reward.bounds}; the lower one must come first")
    for t in transitions():
        value = reward(t)
        require(
            low - _ROUNDING <= value <= high + _ROUNDING,
            f"{_at(t)} it returns {value:g}; its bounds say {low:g} to {high:g}",
        )


@of("reward", "pure")
def pure(reward: RewardTerm) -> None:
    """Check that the reward depends only on the transition."""
    first = [reward(t) for t in transitions()]
    again = [reward(t) for t in reversed(transitions())][::-1]
    for t, value, other in zip(transitions(), first, again, strict=True):
        require(
            value == other,
            f"{_at(t)} it returns {value!r} and, called again, {other!r}; "
            "it may depend only on the transition",
        )


@of("reward", "arrays")
def arrays(reward: RewardTerm) -> None:
    """Check that ``array`` returns what ``__call__`` returns, and does not change its input."""
    for ts in transitions_in_arrays():
        # The next term gets the same arrays, which none may change.
        before = [array.tobytes() for array in _arrays(ts)]
        result: object = reward.array(ts)
        shape, kind = getattr(result, "shape", None), getattr(result, "dtype", np.dtype("O"))
        shown = type(result).__name__ if shape is None else f"one of {kind} and shape {shape}"
        require(
            isinstance(result, np.ndarray) and kind.kind in "fiu" and shape == (len(ts),),
            f"array of {len(ts)} transitions returns {shown}; an array of floats of "
            f"shape ({len(ts)},) is allowed",
        )
        require(
            [array.tobytes() for array in _arrays(ts)] == before,
            "array changes the transitions that it is given",
        )
        for t, value in zip(ts, np.asarray(result).tolist(), strict=True):
            expected = reward(t)
            require(
                abs(value - expected) <= _ROUNDING * max(1.0, abs(expected)),
                f"{_at(t)} array returns {value!r} and __call__ {expected!r}; "
                f"they may differ by {_ROUNDING:g}, relative to values above 1",
            )


def _arrays(ts: Transitions) -> Iterator[np.ndarray]:
    """Yield each array of the transitions and of their states."""
    for part in (ts, ts.before, ts.after):
        values = (getattr(part, field.name) for field in fields(part))
        yield from (value for value in values if isinstance(value, np.ndarray))


def _at(t: Transition) -> str:
    return f"at {t.after.time:.1f} s of an episode ({t.outcome or 'running'})"


@of("measure", "named", everywhere=False)
def named(measure: Measure) -> None:
    """Check that its name is unique among columns, and that tables can show its unit."""
    require(measure.plugin_name in measures(), "is not among the measures of an episode")
    require(bool(measure.unit.strip()), f"has the heading {heading(type(measure))!r}; give a unit")


@of("measure", "values", everywhere=False)
def values(measure: Measure) -> None:
    """Check that values are finite and depend on the episode alone, which they do not change."""
    # Each episode apart, at its first decision and whole
    recorded = _recorded_for(measure, transitions())
    ends = [0, *(at + 1 for at, t in enumerate(recorded) if t.outcome is not None)]
    for episode in (recorded[first:last] for first, last in pairwise(ends)):
        if not applies(measure, episode):
            continue
        before = [t.path.tobytes() for t in episode]
        for part in (episode[:1], episode):
            value, again = measure(part), measure(tuple(part))
            require(
                isinstance(value, Real) and math.isfinite(value),
                f"for {len(part)} decisions ({part[-1].outcome or 'running'}) it returns "
                f"{value!r}; it must return a finite number",
            )
            require(value == again, f"it returns {value!r} and, called again, {again!r}")
        unchanged = [t.path.tobytes() for t in episode] == before
        require(unchanged, "it changes the poses of the episode")


def first_value(measure: Measure) -> float | None:
    """Return the value of an episode on the first scene; None if the measure has none of it."""
    played = decisions(SCENES[0].environment(), SCENES[0].policy, 0)
    episode = _recorded_for(measure, [decision.transition for decision in played])
    return measure(episode) if applies(measure, episode) else None


def _recorded_for(measure: Measure, episode: Sequence[Transition]) -> list[Transition]:
    return [replace(t, perception=_mapped(t)) if measure.mapped_only else t for t in episode]


def _mapped(t: Transition) -> Perception:
    """Return the perception of a sensor that maps the ground and has odometry."""
    assert t.perception is not None  # as in every episode
    seen = np.arange(t.perception.layout.bins) % 3 > 0
    return replace(t.perception, seen=seen, position=1.02 * t.before.position)


@of("logger", "records", everywhere=False)
def records(logger: Logger) -> None:
    """Check that it records a stopped and resumed run and writes only to its own folder."""
    with TemporaryDirectory() as name:
        directory = Path(name)
        for resume_at, steps in ((None, (20, 40)), (20, (40, 60))):
            run = RunInfo(directory, directory / logger.plugin_name, {"seed": 1}, resume_at)
            try:
                listener = logger.open(run)
            except ImportError as error:
                raise NotChecked(str(error)) from error
            for decision in steps:
                listener.episode({**_ROW, "decision": decision})
            listener.validation({**_ROW, "decision": steps[-1]})
            listener.note("a worker was replaced")
            listener.close()
        others = sorted(p.name for p in directory.iterdir() if p.name != logger.plugin_name)
        require(not others, f"writes {others} beside its own folder; write to run.folder")
