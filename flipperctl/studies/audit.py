"""Audit a reward: the contribution of each term over rollouts.

The audit reveals two common mistakes: a term that is too weak to matter, and a term that saturates
at most steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from flipperctl.api import FloatArray, RewardTerm
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.conditions import Conditions
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds


@dataclass(frozen=True)
class TermAudit:
    """Statistics of one term's weighted values over all decisions [-]."""

    weight: float
    mean: float
    lowest: float
    highest: float
    share: float
    """Fraction of the sum of all terms' absolute values, 0 to 1."""
    saturated: float | None
    """Fraction of decisions at the declared lower bound, 0 to 1.

    None if the term declares no lower bound or its weight is 0."""


@dataclass(frozen=True)
class AuditResult:
    """The rewards of a policy on a terrain, term by term."""

    controller: str
    """Label of the policy."""
    terrain: str
    episodes: int
    decisions: int
    mean_return: float
    """Sum of all weighted terms over an episode, averaged over the episodes [-]."""
    terms: Mapping[str, TermAudit]
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions

    def to_dict(self) -> dict[str, Any]:
        """Return the document of ``inspect reward --json``."""
        return {
            "controller": self.controller,
            "terrain": self.terrain,
            "episodes": self.episodes,
            "decisions": self.decisions,
            "return": self.mean_return,
            "terms": {name: asdict(term) for name, term in self.terms.items()},
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
        }


def audit(
    config: EvalConfig,
    source: PolicySource,
    *,
    episodes: int,
    report: Callable[[float], None] = lambda done: None,
) -> AuditResult:
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
    return AuditResult(
        source.label(),
        config.terrain.plugin_name,
        episodes,
        decisions=len(next(iter(values.values()), np.empty(0))),
        mean_return=sum(float(column.sum()) for column in values.values()) / episodes,
        terms={name: _term(config.rewards[name], v, total) for name, v in values.items()},
        seed=config.eval.seed,
        conditions=Conditions.of(config),
    )


def _term(term: RewardTerm, values: FloatArray, total: float) -> TermAudit:
    """Summarise the (D,) weighted values of a term; ``total`` is the absolute sum of all terms."""
    floor, sign = term.bounds[0] * term.weight, np.sign(term.weight)
    floored = math.isfinite(floor) and sign != 0
    return TermAudit(
        weight=term.weight,
        mean=float(values.mean()),
        lowest=float(values.min()),
        highest=float(values.max()),
        share=float(np.abs(values).sum()) / total if total else 0.0,
        saturated=float((sign * values <= sign * floor).mean()) if floored else None,
    )
