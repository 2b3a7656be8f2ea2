"""Rows and results made by hand."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from flipperctl.config import EvalConfig
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.rows import Episodes, Row, arranged
from flipperctl.policies.source import PolicySource


def sample(seed: int, outcome: str, value: float, terrain: str = "step", **more: Any) -> Row:
    """Return an episode whose θ̂_R is ``value`` [rad], at 100 Hz twice, its t_cost ten times [s]."""
    row = {
        "episode": seed,
        "seed": seed,
        "outcome": outcome,
        "terrain": terrain,
        "decisions": 20,
        "t_cost": 10 * value,
        "pitch_variation_decisions": value,
        "pitch_variation_100hz": 2 * value,
        "max_pitch": 0.1 * value,
        "flipper_travel": 3 * value,
        "return": -value,
        "reward_pitch": -value,
        "start_shift": 0.01,
    }
    return arranged(row | more)


def episodes(rows: Sequence[Row]) -> Episodes:
    return Episodes(tuple(rows))


def entry(label: str, terrain: str = "step", **more: Any) -> Entry:
    """Return an entry of a policy that is known by its label alone."""
    config = EvalConfig(terrain=terrain)
    return replace(Entry(config, PolicySource(settings={"name": label})), **more)


def result(
    ours: Sequence[Row],
    others: Mapping[str, Sequence[Row]] = {},
    label: str = "mine",
    terrain: str = "step",
) -> Result:
    """Return the result of one policy on one scene, with its baselines."""
    mine = entry(label, terrain)
    played = [Played(mine, episodes(ours))]
    for name, rows in others.items():
        source = PolicySource(settings={"name": name})
        other = replace(mine, source=source, is_baseline=True)
        played.append(Played(other, episodes(rows)))
    plan = Plan(tuple(one.entry for one in played), label)
    return Result(plan, tuple(played))
