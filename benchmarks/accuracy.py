"""Accuracy by the simulator's substep: θ̂_R compared with finer substeps.

A rule crosses the paper's scenes from several starts at each substep. In addition, single episodes
of the shipped policy and of the rule are compared on all kinds of ground, each at the configured
substep and at a finer one: a policy near its limits amplifies small differences, and a rule that
follows the ground does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.settings import FAMILIES, Benchmark, planar, quantity, ratio
from flipperctl import checkpoint
from flipperctl.api import SAMPLE_PERIOD
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.rollout.episode import EvaluationSeeds, Row, play

ABOUT = (
    "θ̂_R of a rule at 100 Hz and at decisions on the paper's scenes, from several starts, by "
    "substep; ratios against a quarter of the configured substep; relative changes of single "
    "episodes with a policy, and the fraction of outcomes that change"
)
MEASURES = {"100hz.": "pitch_variation_100hz", "": "pitch_variation_decisions"}
"""θ̂_R at 100 Hz and at decisions: a part of a quantity's name, and the measure."""
SCENES = ("paper_step", "paper_stair")
FACTORS = (2.0, 1.0, 0.5, 0.25)
"""Substeps as multiples of the configured one [-]; the last one is the reference."""
SHIPPED = "generalist"
"""The shipped policy that is measured."""
_RULE = 0.4
"""Fraction of the progress bar for the rule on the paper's scenes; policies take the rest."""
_KEY = "pitch_variation_100hz"


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure θ̂_R [rad] by scene and substep [ms], its ratios, and changes with a policy [-]."""
    # The sample period is the coarsest substep that the simulator accepts.
    substeps = [f * planar(bench.config.sim).substep for f in FACTORS]
    substeps = [step for step in substeps if step <= SAMPLE_PERIOD * (1 + 1e-9)]
    runs = [(scene, step) for scene in SCENES for step in substeps]
    rule, rows = load_policy(bench.settings.controller, "bench.controller"), {}
    for index, (scene, step) in enumerate(runs):
        bench.report_progress(f"{scene} at {1e3 * step:g} ms", _RULE * index / len(runs))
        config = with_overrides(bench.config.environment(), {"terrain": scene, "sim.substep": step})
        rows[scene, step] = [row for (row,) in _play(bench, rule, config, config)]
    quantities: dict[str, Any] = {}
    ratios: dict[str, Any] = {}
    for prefix, key in MEASURES.items():
        names = {run: f"{run[0]}.{prefix}{1e3 * run[1]:g}ms" for run in runs}
        values = {
            run: [row[key] if row["outcome"] == "reached" else None for row in found]
            for run, found in rows.items()
        }
        quantities |= {names[run]: quantity(values[run], "rad") for run in runs}
        for scene, step in runs:
            if step != (finest := substeps[-1]):
                name = f"{names[scene, step]} / {names[scene, finest]}"
                ratios[name] = ratio(values[scene, step], values[scene, finest])
    policies = _measure_policies(bench, rule)
    quantities |= policies.pop("quantities")
    return {"about": ABOUT, "quantities": quantities, "ratios": ratios, **policies}


def _play(
    bench: Benchmark, source: PolicySource, config: EnvConfig, *played_in: EnvConfig
) -> list[tuple[Row, ...]]:
    """Play an episode from each start, in each of the environments."""
    envs = [FlipperEnv(config=one) for one in played_in]
    policy = source.build(config)
    seeds = EvaluationSeeds.of(bench.settings.seed, config.terrain).first(bench.settings.starts)
    return [tuple(play(env, policy, seed) for env in envs) for seed in seeds]


def _measure_policies(bench: Benchmark, rule: PolicySource) -> dict[str, Any]:
    """Measure relative changes of θ̂_R and changed outcomes [-], by policy and by terrain."""
    sources = {
        bench.settings.controller: rule,
        SHIPPED: PolicySource(checkpoint=checkpoint.shipped_policies()[SHIPPED]),
    }
    runs = [(name, f) for name in sources for f in FAMILIES[: bench.settings.families]]
    played: dict[str, dict[str, list[tuple[Row, ...]]]] = {name: {} for name in sources}
    missing: list[str] = []
    for index, (name, family) in enumerate(runs):
        done = _RULE + (1 - _RULE) * index / len(runs)
        bench.report_progress(f"{name} on {family} at two substeps", done)
        config = with_overrides(bench.config.environment(), {"terrain": family})
        finer = with_overrides(config, {"sim.substep": FACTORS[-1] * planar(config.sim).substep})
        try:
            played[name][family] = _play(bench, sources[name], config, config, finer)
        except CheckpointError as error:  # the policy needs another observation layout
            missing = [str(error)]
    quantities: dict[str, Any] = {}
    for name, by_family in played.items():
        pairs = [pair for family in by_family.values() for pair in family]
        if values := changes(pairs):
            quantities[f"{name}.change"] = quantity(values, "-")
        if pairs:
            quantities[f"{name}.changed_outcomes"] = quantity([changed_outcomes(pairs)], "-")
    return {"quantities": quantities, "missing": missing}


def changes(pairs: Sequence[tuple[Row, ...]]) -> list[float]:
    """Return |θ̂_R / θ̂_R at the finer substep − 1| of each episode that reaches with both [-]."""
    return [
        abs(coarse[_KEY] / fine[_KEY] - 1)
        for coarse, fine in pairs
        if coarse["outcome"] == fine["outcome"] == "reached" and fine[_KEY] > 0
    ]


def changed_outcomes(pairs: Sequence[tuple[Row, ...]]) -> float:
    """Return the fraction of the episodes whose outcome differs [-]."""
    return sum(str(a["outcome"]) != str(b["outcome"]) for a, b in pairs) / len(pairs)
