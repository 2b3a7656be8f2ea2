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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from flipperctl import entry, plugins
from flipperctl.api import (
    FloatArray,
    Outcome,
    Perception,
    Policy,
    SharedSetting,
    Simulator,
    action_index,
)
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, EvalConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Row, decisions
from flipperctl.rollout.seeds import EvaluationSeeds
from flipperctl.show import Column, Table, print_table
from flipperctl.terminal.console import console

PITCH_TOLERANCE = 0.05
"""Largest RMS difference of the pitches at equal times that counts as equal [rad]."""
TIME_TOLERANCE = 0.03
"""Largest relative difference of the times to the finish that counts as equal [-]."""
_ALONG = 0.002
"""Distance between places at which pitches are compared, as driven in one sample [m]."""

_SHARED: tuple[SharedSetting, ...] = ("friction", "gravity")
"""Settings that the default engine takes from the other one."""
Config = TypeVar("Config", bound=EnvConfig)


@dataclass(frozen=True)
class EngineEpisode:
    """One episode, played in the default engine and repeated in the other one."""

    episode: int
    """Index of the episode in the evaluation, from 0."""
    seed: int
    terrain: str
    """Label of the sampled profile."""
    outcomes: tuple[Outcome, Outcome]
    """Outcomes in the default engine and in the other one."""
    times: tuple[float, float]
    """Times to the end of the episode [s]."""
    swings: tuple[float, float]
    """θ̂_R at 100 Hz [rad]."""
    pitch_rms: float
    """RMS difference of the pitches at equal times, until the first one ends [rad]."""
    pitch_rms_along: float
    """The same at equal x, each at its first crossing; a mere delay does not change it [rad]."""
    parts_at: tuple[float, float] | None
    """Time [s] and x [m] from which the pitches differ by more than ``PITCH_TOLERANCE``; None if
    they never do."""

    @property
    def equal_outcomes(self) -> bool:
        """Whether both engines lead to the same outcome."""
        return self.outcomes[0] is self.outcomes[1]

    @property
    def both_reached(self) -> bool:
        """Whether the finish was reached in both."""
        return self.equal_outcomes and self.outcomes[0] is Outcome.REACHED

    @property
    def time_ratio(self) -> float:
        """Time in the other engine divided by that in the default one, minus 1 [-]."""
        return self.times[1] / self.times[0] - 1.0

    @property
    def agrees(self) -> bool:
        """Whether outcomes, times and pitches are equal within the tolerances."""
        near = self.pitch_rms <= PITCH_TOLERANCE and abs(self.time_ratio) <= TIME_TOLERANCE
        return self.equal_outcomes and (near or not self.both_reached)


def summary(terrain: str, episodes: Sequence[EngineEpisode]) -> dict[str, Any]:
    """Return the row of a terrain's E episodes; means are over those that both engines reached."""
    reached = [e for e in episodes if e.both_reached]

    def mean(values: Iterable[float]) -> float | None:
        return float(np.mean(list(values))) if reached else None

    return {
        "terrain": terrain,
        "episodes": str(len(episodes)),
        "equal_outcomes": str(sum(e.equal_outcomes for e in episodes)),
        "reached": str(len(reached)),
        "agree": str(sum(e.agrees for e in episodes)),
        "pitch_rms": mean(e.pitch_rms for e in reached),
        "most_pitch_rms": max((e.pitch_rms for e in reached), default=None),
        "time": mean(100 * e.time_ratio for e in reached),
        "most_time": max((100 * e.time_ratio for e in reached), key=abs, default=None),
        "first": mean(e.swings[0] for e in reached),
        "second": mean(e.swings[1] for e in reached),
    }


def in_default_engine(config: Config) -> Config:
    """Return the configuration in the default engine, with the same friction and gravity.

    Raises:
        ConfigError: the configuration already uses that engine, or samples what it does not have.
    """
    sim = config.sim
    if sim.plugin_name == DEFAULT_ENGINE:
        raise ConfigError(
            f"sim: sim={DEFAULT_ENGINE} is the engine to compare with; "
            "choose another one, such as sim=mujoco"
        )
    known = {name: sim.shared_setting(name) for name in _SHARED}
    shared: dict[str, Any] = {name: value for name, value in known.items() if value is not None}
    plane = resolver.create("sim", {"name": DEFAULT_ENGINE, **shared}, "sim")
    sampled = (one for one in config.randomise.sampled() if one.section == "sim")
    if foreign := [one.key for one in sampled if one.field not in type(plane).model_fields]:
        raise ConfigError(
            f"{', '.join(foreign)}: sim={DEFAULT_ENGINE}, the engine to compare with, has no such "
            f"setting; add {' '.join(f'{key}=null' for key in foreign)}"
        )
    return config.model_copy(update={"sim": plane})


def compare_engines(config: EvalConfig, source: PolicySource) -> list[EngineEpisode]:
    """Play the evaluation's episodes in the default engine and repeat them in ``config``'s.

    Raises:
        ConfigError: ``config`` uses the default engine.
        FlipperctlError: the policy cannot be built or failed.
    """
    first, second = FlipperEnv(config=in_default_engine(config)), FlipperEnv(config=config)
    policy = source.build(config)
    seeds, found = EvaluationSeeds.of(config.eval.seed, config.terrain), []
    for index in range(config.eval.episodes):
        seed = seeds(index)
        actions, ours, row = _play(first, policy, seed)
        _, theirs, other = _play(second, _Repeat(actions), seed)
        found.append(_episode(index, (row, other), (ours, theirs)))
    return found


class _Repeat:
    """A policy that repeats given actions and then holds the flippers."""

    def __init__(self, actions: Sequence[int]) -> None:
        self._actions = actions

    def reset(self, simulator: Simulator) -> None:
        self._next = iter(self._actions)

    def act(self, p: Perception) -> int:
        return next(self._next, action_index(0, 0))


def _play(env: FlipperEnv, policy: Policy, seed: int) -> tuple[list[int], FloatArray, Row]:
    """Play an episode; return its actions, its poses at 100 Hz, (S, 5), and its result."""
    actions, poses, ending = [], [], None
    for decision in decisions(env, policy, seed):
        actions.append(int(decision.action))
        poses.append(decision.poses[1:])
        ending = decision.ending
    assert ending is not None  # decisions() yields until there is one
    return actions, np.concatenate(poses), ending


def _episode(
    index: int, rows: tuple[Row, Row], poses: tuple[FloatArray, FloatArray]
) -> EngineEpisode:
    first, second = rows
    both = min(map(len, poses))
    x, pitch = poses[0][:both, 0], poses[0][:both, 2]
    differences = np.abs(poses[1][:both, 2] - pitch)
    apart = np.flatnonzero(differences > PITCH_TOLERANCE)
    parts_at = None
    if apart.size:
        sample = int(apart[0])
        parts_at = round(0.01 * (sample + 1), 2), float(x[sample])
    return EngineEpisode(
        index,
        first["seed"],
        first["terrain"],
        (Outcome(first["outcome"]), Outcome(second["outcome"])),
        (first["t_cost"], second["t_cost"]),
        (first["pitch_variation_100hz"], second["pitch_variation_100hz"]),
        math.sqrt(float((differences**2).mean())),
        _pitch_rms_along(*poses),
        parts_at,
    )


def _pitch_rms_along(first: FloatArray, second: FloatArray) -> float:
    """Return the RMS difference of the pitches at equal x; both arrays are (S, 5) [rad]."""
    distances = [np.maximum.accumulate(poses[:, 0]) for poses in (first, second)]
    begin, end = max(d[0] for d in distances), min(d[-1] for d in distances)
    x = np.arange(begin, end, _ALONG)
    ours, theirs = (
        poses[np.searchsorted(d, x), 2] for d, poses in zip(distances, (first, second), strict=True)
    )
    return math.sqrt(float(((ours - theirs) ** 2).mean())) if len(x) else 0.0


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the rows and the episodes on which the engines disagree."""
    from flipperctl.cli.scenes import scenes

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.engine_agreement",
        description="Compare two engines on the same commanded actions.",
    )
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as in terrain=step,stair")
    parser.add_argument("--controller", default="okada", help="whose actions [%(default)s]")
    parser.add_argument("--episodes", type=int, default=10, help="of each terrain [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the episodes [0]")
    chosen = parser.parse_args(arguments)
    plugins.load([])
    words = [f"eval.episodes={chosen.episodes}", f"eval.seed={chosen.seed}", *chosen.overrides]
    if not any(word.startswith("sim=") for word in words):
        words.append("sim=mujoco")
    asked = scenes(words, None, chosen.controller)
    for config, _ in asked:
        in_default_engine(config)  # it raises before the first episode
    rows, apart = [], []
    for config, source in asked:
        name = config.terrain.plugin_name
        found = compare_engines(config, source)
        rows.append(summary(name, found))
        apart += [f"{name}, {_disagreement(e)}" for e in found if not e.agrees]
    title = f"{asked[0][0].sim.plugin_name} against {DEFAULT_ENGINE}, {chosen.controller}'s actions"
    print_table(Table(_COLUMNS, rows, title), console())
    for line in apart:
        print(line)
    return 0


def _disagreement(e: EngineEpisode) -> str:
    """Return an episode on which the engines disagree as a line."""
    where = ""
    if e.parts_at is not None:
        where = f"; they diverge at {e.parts_at[0]:.2f} s, x {e.parts_at[1]:.2f} m"
    return (
        f"episode {e.episode} (seed {e.seed}): {e.outcomes[0]} in {e.times[0]:.1f} s, "
        f"{e.outcomes[1]} in {e.times[1]:.1f} s, pitch RMS {e.pitch_rms:.3f} rad, "
        f"{e.pitch_rms_along:.3f} rad at equal x{where}"
    )


if __name__ == "__main__":
    entry.run(main)
