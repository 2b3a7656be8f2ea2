"""Accuracy of the physics with a policy: single episodes at finer substeps.

A policy near its limits amplifies small differences, and a rule that follows the ground does not.
Therefore the shipped policy and a rule play the same episodes, each at the configured substep and
at a finer one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.planar import planar
from benchmarks.settings import FAMILIES, Benchmark
from flipperctl import checkpoint
from flipperctl.bench.settings import quantity
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Row, play
from flipperctl.rollout.seeds import EvaluationSeeds

SHIPPED = "generalist"
"""The shipped policy that is measured."""
FINER = 0.25
"""The finer substep as a multiple of the configured one [-]."""
_KEY = "pitch_variation_100hz"


def measure_policies(bench: Benchmark, begun: float) -> dict[str, Any]:
    """Measure relative changes of θ̂_R and changed outcomes [-], by policy and by terrain.

    ``begun``: fraction of the whole benchmark that is finished before this part.
    """
    sources = {
        bench.settings.controller: PolicySource.of_plugin(
            bench.settings.controller, "bench.controller"
        ),
        SHIPPED: PolicySource(checkpoint=checkpoint.shipped_policies()[SHIPPED]),
    }
    families = FAMILIES[: bench.settings.families]
    quantities: dict[str, Any] = {}
    missing: list[str] = []
    runs = [(name, family) for name in sources for family in families]
    found: dict[str, dict[str, list[tuple[Row, Row]]]] = {name: {} for name in sources}
    for index, (name, family) in enumerate(runs):
        done = begun + (1 - begun) * index / len(runs)
        bench.report_progress(f"{name} on {family} at two substeps", done)
        config = with_overrides(bench.config.environment(), {"terrain": family})
        try:
            found[name][family] = _play_both(bench, config, sources[name])
        except CheckpointError as error:  # the policy needs another observation layout
            missing = [str(error)]
    for name, by_family in found.items():
        pairs = [pair for family in by_family.values() for pair in family]
        if values := changes(pairs):
            quantities[f"{name}.change"] = quantity(values, "-")
        if pairs:
            quantities[f"{name}.changed_outcomes"] = quantity([changed_outcomes(pairs)], "-")
    by_terrain = {
        name: {
            family: {"changes": changes(pairs), "changed_outcomes": changed_outcomes(pairs)}
            for family, pairs in by_family.items()
        }
        for name, by_family in found.items()
    }
    return {"quantities": quantities, "by_terrain": by_terrain, "missing": missing}


def changes(pairs: Sequence[tuple[Row, Row]]) -> list[float]:
    """Return |θ̂_R / θ̂_R at the finer substep − 1| of each episode that reaches with both [-]."""
    return [
        abs(coarse[_KEY] / fine[_KEY] - 1)
        for coarse, fine in pairs
        if coarse["outcome"] == fine["outcome"] == "reached" and fine[_KEY] > 0
    ]


def changed_outcomes(pairs: Sequence[tuple[Row, Row]]) -> float:
    """Return the fraction of the episodes whose outcome differs [-]."""
    changed = [str(coarse["outcome"]) != str(fine["outcome"]) for coarse, fine in pairs]
    return sum(changed) / len(changed)


def _play_both(bench: Benchmark, config: EnvConfig, source: PolicySource) -> list[tuple[Row, Row]]:
    """Play each episode at the configured and at the finer substep."""
    s = bench.settings
    finer = {"sim.substep": FINER * planar(config.sim).substep}
    envs = [FlipperEnv(config=c) for c in (config, with_overrides(config, finer))]
    policy = source.build(config)
    pairs = []
    for seed in EvaluationSeeds.of(s.seed, config.terrain).first(s.starts):
        coarse, fine = (play(env, policy, seed) for env in envs)
        pairs.append((coarse, fine))
    return pairs
