"""Audit a reward: the contribution of each term over rollouts.

The audit reveals two common mistakes: a term that is too weak to matter, and a term that saturates
at most steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from flipperctl.api import FloatArray, RewardTerm
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.views.summary import Document
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds
from flipperctl.show import Column, Table


def audit(
    config: EvalConfig,
    source: PolicySource,
    *,
    episodes: int,
    report: Callable[[float], None] = lambda done: None,
) -> Document:
    """Play the first episodes of an evaluation and summarise each reward term.

    ``report`` is called with the number of finished episodes; a controller's search before an
    episode counts as a fraction of it.

    Raises:
        FlipperctlError: the policy cannot be built or failed.
    """
    env = FlipperEnv(config=config)
    policy = source.build(config)
    seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
    collected: dict[str, list[float]] = {name: [] for name in config.rewards}
    for index in range(episodes):

        def search(fraction: float, before: int = index) -> None:
            report(before + fraction)

        for decision in decisions(env, policy, seeds(index), report_progress=search):
            for name, value in decision.rewards.items():
                collected[name].append(value)
        report(index + 1.0)
    values = {name: np.array(column) for name, column in collected.items()}  # each (D,)
    total = sum(float(np.abs(column).sum()) for column in values.values())
    return {
        "controller": source.label(),
        "terrain": config.terrain.plugin_name,
        "episodes": episodes,
        "decisions": len(next(iter(values.values()), np.empty(0))),
        "return": sum(float(column.sum()) for column in values.values()) / episodes,
        "terms": {name: _term(config.rewards[name], v, total) for name, v in values.items()},
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
    }


def _term(term: RewardTerm, values: FloatArray, total: float) -> Document:
    """Summarise the (D,) weighted values of a term; ``total`` is the absolute sum of all terms.

    ``share``: fraction of that sum; ``saturated``: fraction of decisions at the declared lower
    bound, None without one or at a weight of 0.
    """
    floor, sign = term.bounds[0] * term.weight, np.sign(term.weight)
    floored = math.isfinite(floor) and sign != 0
    return {
        "weight": term.weight,
        "mean": float(values.mean()),
        "lowest": float(values.min()),
        "highest": float(values.max()),
        "share": float(np.abs(values).sum()) / total if total else 0.0,
        "saturated": float((sign * values <= sign * floor).mean()) if floored else None,
    }


_COLUMNS = (
    Column("term", "term", named=True),
    Column("weight", "weight"),
    Column("mean", "mean of a decision", 4),
    Column("lowest", "lowest", 3),
    Column("highest", "highest", 3),
    Column("share_text", "share of the return"),
    Column("saturated_text", "saturated"),
)


def table(found: Document, notes: Sequence[str] = ()) -> Table:
    """Return a row for each term, with lines below the table."""
    rows = [
        {
            "term": name,
            **one,
            "share_text": f"{one['share']:.1%}",
            "saturated_text": "–" if one["saturated"] is None else f"{one['saturated']:.1%}",
        }
        for name, one in found["terms"].items()
    ]
    title = (
        f"{found['controller']} on {found['terrain']} · {found['episodes']} episodes, "
        f"{found['decisions']} decisions · mean return {found['return']:.2f}"
    )
    return Table(_COLUMNS, rows, title, list(notes))
