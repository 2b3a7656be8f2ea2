"""Compare two engines on the same commanded actions.

    python -m benchmarks.engine_agreement [--controller NAME] [--episodes N] [--seed N] [OVERRIDE …]

A policy acts in the default engine, that of the side plane; the other engine (``sim=mujoco`` unless
an OVERRIDE chooses another one) repeats its actions regardless of their effect, so that only
physics differs. Engines agree on an episode if the outcomes are equal and, where both reach the
finish, the pitches differ by at most 0.05 rad RMS at equal times and the times by at most 3 %. The
output has a row for each terrain, and a line for each episode on which they disagree, with the time
and the place from which the pitches differ. Pitches that differ at equal times but not at equal x
are the same motion with a delay.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, Outcome, Perception, Policy, Simulator, action_index
from flipperctl.config import DEFAULT_ENGINE, EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.evaluation.engines import in_default_engine
from flipperctl.plugging import plugins
from flipperctl.policies.source import PolicySource
from flipperctl.process import entry
from flipperctl.rollout.episode import EvaluationSeeds, Row, decisions
from flipperctl.text.show import Column, Table, console, print_table

PITCH_TOLERANCE = 0.05
"""Largest RMS difference of the pitches at equal times that counts as equal [rad]."""
TIME_TOLERANCE = 0.03
"""Largest relative difference of the times to the finish that counts as equal [-]."""
_ALONG = 0.002
"""Distance between places at which pitches are compared, as driven in one sample [m]."""
_COLUMNS = (
    Column("terrain", "terrain", named=True),
    Column("episodes", "episodes"),
    Column("equal_outcomes", "equal outcomes"),
    Column("reached", "both reached"),
    Column("agree", "agree"),
    Column("pitch_rms", "pitch RMS [rad]", 3),
    Column("most_pitch_rms", "largest", 3),
    Column("time", "time [%]", 1, "+"),
    Column("most_time", "largest", 1, "+"),
    Column("first", "θ̂_R, plane [rad]"),
    Column("second", "other"),
)


@dataclass(frozen=True)
class Pair:
    """One episode, played in the default engine and repeated in the other one."""

    rows: tuple[Row, Row]
    poses: tuple[FloatArray, FloatArray]
    """Poses at 100 Hz in both, (S, 5) each."""

    @property
    def differences(self) -> FloatArray:
        """Absolute differences of the pitches at equal times, until the first one ends [rad]."""
        both = min(map(len, self.poses))
        return np.abs(self.poses[1][:both, 2] - self.poses[0][:both, 2])

    @property
    def pitch_rms(self) -> float:
        """RMS difference of the pitches at equal times [rad]."""
        return _rms(self.differences)

    @property
    def pitch_rms_along(self) -> float:
        """The same at equal x, each at its first crossing; a mere delay does not change it."""
        distances = [np.maximum.accumulate(poses[:, 0]) for poses in self.poses]
        x = np.arange(max(d[0] for d in distances), min(d[-1] for d in distances), _ALONG)
        ours, theirs = (
            poses[np.searchsorted(d, x), 2] for d, poses in zip(distances, self.poses, strict=True)
        )
        return _rms(ours - theirs)

    @property
    def equal_outcomes(self) -> bool:
        """Whether both engines lead to the same outcome."""
        return bool(self.rows[0]["outcome"] == self.rows[1]["outcome"])

    @property
    def both_reached(self) -> bool:
        """Whether the finish was reached in both."""
        return self.equal_outcomes and self.rows[0]["outcome"] == Outcome.REACHED

    @property
    def time_ratio(self) -> float:
        """Time in the other engine divided by that in the default one, minus 1 [-]."""
        return float(self.rows[1]["t_cost"] / self.rows[0]["t_cost"] - 1.0)

    @property
    def agrees(self) -> bool:
        """Whether outcomes, times and pitches are equal within the tolerances."""
        near = self.pitch_rms <= PITCH_TOLERANCE and abs(self.time_ratio) <= TIME_TOLERANCE
        return self.equal_outcomes and (near or not self.both_reached)

    def text(self) -> str:
        """Return both ends, and where the pitches begin to differ, as a line."""
        ends = (f"{row['outcome']} in {row['t_cost']:.1f} s" for row in self.rows)
        apart, where = np.flatnonzero(self.differences > PITCH_TOLERANCE), ""
        if apart.size:
            x = self.poses[0][apart[0], 0]
            where = f"; they diverge at {0.01 * (apart[0] + 1):.2f} s, x {x:.2f} m"
        return (
            f"seed {self.rows[0]['seed']}: {', '.join(ends)}, pitch RMS {self.pitch_rms:.3f} rad, "
            f"{self.pitch_rms_along:.3f} rad at equal x{where}"
        )


def _rms(values: FloatArray) -> float:
    return math.sqrt(float((values**2).mean())) if len(values) else 0.0


def compare_engines(config: EvalConfig, source: PolicySource) -> list[Pair]:
    """Play the evaluation's episodes in the default engine and repeat them in ``config``'s."""
    first, second = FlipperEnv(config=in_default_engine(config)), FlipperEnv(config=config)
    policy, found = source.build(config), []
    for seed in EvaluationSeeds.of(config.eval.seed, config.terrain).first(config.eval.episodes):
        actions, ours, row = play(first, policy, seed)
        _, theirs, other = play(second, _Repeat(actions), seed)
        found.append(Pair((row, other), (ours, theirs)))
    return found


class _Repeat:
    """A policy that repeats given actions and then holds the flippers."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._actions = actions

    def reset(self, simulator: Simulator) -> None:
        self._next = iter(self._actions)

    def act(self, p: Perception) -> int:
        return next(self._next, action_index(0, 0))


def play(env: FlipperEnv, policy: Policy, seed: int) -> tuple[list[int], FloatArray, Row]:
    """Play an episode; return its actions, its poses at 100 Hz, (S, 5), and its result."""
    actions, poses, ending = [], [], None
    for decision in decisions(env, policy, seed):
        actions.append(int(decision.action))
        poses.append(decision.poses[1:])
        ending = decision.ending
    assert ending is not None  # decisions() yields until there is one
    return actions, np.concatenate(poses), ending


def summary(terrain: str, pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the row of a terrain; means are over the episodes that both engines reached."""
    reached = [pair for pair in pairs if pair.both_reached]

    def mean(value: Callable[[Pair], float]) -> float | None:
        return float(np.mean([value(pair) for pair in reached])) if reached else None

    return {
        "terrain": terrain,
        "episodes": str(len(pairs)),
        "equal_outcomes": str(sum(pair.equal_outcomes for pair in pairs)),
        "reached": str(len(reached)),
        "agree": str(sum(pair.agrees for pair in pairs)),
        "pitch_rms": mean(lambda pair: pair.pitch_rms),
        "most_pitch_rms": max((pair.pitch_rms for pair in reached), default=None),
        "time": mean(lambda pair: 100 * pair.time_ratio),
        "most_time": max((100 * pair.time_ratio for pair in reached), key=abs, default=None),
        "first": mean(lambda pair: pair.rows[0]["pitch_variation_100hz"]),
        "second": mean(lambda pair: pair.rows[1]["pitch_variation_100hz"]),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the rows and the episodes on which the engines disagree."""
    from flipperctl.requests.plan import scenes
    from flipperctl.requests.text import from_words

    parser = argparse.ArgumentParser(prog="python -m benchmarks.engine_agreement")
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as in terrain=step,stair")
    parser.add_argument("--controller", default="okada", help="whose actions [%(default)s]")
    parser.add_argument("--episodes", type=int, default=10, help="of each terrain [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the episodes [0]")
    chosen = parser.parse_args(arguments)
    plugins.load([])
    words = [f"eval.episodes={chosen.episodes}", f"eval.seed={chosen.seed}", *chosen.overrides]
    if not any(word.startswith("sim=") for word in words):
        words.append("sim=mujoco")
    asked = scenes(from_words(words), None, chosen.controller)
    if asked[0][0].sim.plugin_name == DEFAULT_ENGINE:
        raise RequestError(f"sim={DEFAULT_ENGINE} is the engine to compare with; choose another")
    for config, _ in asked:
        in_default_engine(config)  # it raises before the first episode
    rows, apart = [], []
    for config, source in asked:
        name = config.terrain.plugin_name
        pairs = compare_engines(config, source)
        rows.append(summary(name, pairs))
        apart += [f"{name}, {pair.text()}" for pair in pairs if not pair.agrees]
    title = f"{asked[0][0].sim.plugin_name} against {DEFAULT_ENGINE}, {chosen.controller}'s actions"
    print_table(Table(_COLUMNS, rows, title), console())
    for line in apart:
        print(line)
    return 0


if __name__ == "__main__":
    entry.run(main)
