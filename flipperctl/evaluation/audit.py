"""The audit of a reward: what each term pays over rollouts.

It shows the mistakes that earlier re-implementations made: a term too weak to matter, and a term
that saturates at most steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import episode_seed


def audit(
    config: EnvConfig,
    source: PolicySource,
    *,
    episodes: int,
    seed: int,
    report: Callable[[float], None] = lambda done: None,
) -> dict[str, Any]:
    """Play the episodes of an evaluation and sum up each term.

    ``report`` is told how many episodes are done, a search before an episode as a part of it.

    For each: ``mean``, ``lowest`` and ``highest`` weighted value of a decision; ``share``, its
    part of the sum of all terms' absolute values; ``saturated``, the fraction of decisions at
    its declared lower bound (None if it declares none, or weighs nothing).
    """
    env = FlipperEnv(config=config)
    controller = source.build(config.perception)
    paid: dict[str, list[float]] = {name: [] for name in config.rewards}
    for index in range(episodes):

        def search(share: float, before: int = index) -> None:
            report(before + share)

        drawn = episode_seed("evaluation", seed, index)
        for decision in decisions(env, controller, drawn, report_progress=search):
            for name, value in decision.rewards.items():
                paid[name].append(value)
        report(index + 1.0)
    values = {name: np.array(column) for name, column in paid.items()}
    whole = sum(float(np.abs(column).sum()) for column in values.values())
    terms: dict[str, Any] = {}
    for name, column in values.items():
        term = config.rewards[name]
        floor, sign = term.bounds[0] * term.weight, np.sign(term.weight)
        floored = math.isfinite(floor) and sign != 0
        terms[name] = {
            "weight": term.weight,
            "mean": float(column.mean()),
            "lowest": float(column.min()),
            "highest": float(column.max()),
            "share": float(np.abs(column).sum()) / whole if whole else 0.0,
            "saturated": float((sign * column <= sign * floor).mean()) if floored else None,
        }
    return {
        "controller": source.label(),
        "terrain": config.terrain.plugin_name,
        "episodes": episodes,
        "decisions": len(next(iter(values.values()), np.empty(0))),
        "return": sum(float(column.sum()) for column in values.values()) / episodes,
        "terms": terms,
    }
