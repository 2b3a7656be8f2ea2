"""Accuracy by the simulator's substep: θ̂_R on the paper's scenes compared with finer substeps.

The same controller crosses the same scene from several starts at each substep. In addition, single
episodes of the shipped policy and of the controller are compared on all kinds of ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from benchmarks.planar import planar
from benchmarks.policy_accuracy import measure_policies
from benchmarks.settings import Benchmark
from flipperctl.api import SAMPLE_PERIOD
from flipperctl.bench.settings import quantity, ratio
from flipperctl.config import with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Row, play
from flipperctl.rollout.seeds import EvaluationSeeds

ABOUT = (
    "θ̂_R of a rule at 100 Hz and at decisions on the paper's scenes, from several starts, by "
    "substep; ratios against a quarter of the configured substep; relative changes of single "
    "episodes with a policy, and the fraction of outcomes that change"
)
MEASURES = {"100hz.": "pitch_variation_100hz", "": "pitch_variation"}
"""θ̂_R at 100 Hz and at decisions: a part of a quantity's name, and the measure."""
SCENES = ("paper_step", "paper_stair")
FACTORS = (2.0, 1.0, 0.5, 0.25)
"""Substeps as multiples of the configured one [-]; the last one is the reference."""
_RULE = 0.4
"""Fraction of the progress bar for the rule on the paper's scenes; policies take the rest."""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure θ̂_R [rad] by scene and substep [ms], its ratios, and changes with a policy [-]."""
    # The sample period is the coarsest substep that the simulator accepts.
    substeps = [f * planar(bench.config.sim).substep for f in FACTORS]
    substeps = [step for step in substeps if step <= SAMPLE_PERIOD * (1 + 1e-9)]
    runs = [(scene, step) for scene in SCENES for step in substeps]
    found: dict[tuple[str, float], list[Row]] = {}
    for index, (scene, step) in enumerate(runs):
        bench.report_progress(f"{scene} at {1e3 * step:g} ms", _RULE * index / len(runs))
        found[scene, step] = _play(bench, scene, step)
    quantities: dict[str, Any] = {}
    ratios: dict[str, Any] = {}
    for prefix, key in MEASURES.items():
        names = {run: f"{run[0]}.{prefix}{1e3 * run[1]:g}ms" for run in runs}
        values = {run: _variations(rows, key) for run, rows in found.items()}
        quantities |= {names[run]: quantity(values[run], "rad") for run in runs}
        for scene, step in runs:
            if step != (finest := substeps[-1]):
                name = f"{names[scene, step]} / {names[scene, finest]}"
                ratios[name] = ratio(values[scene, step], values[scene, finest])
    policies = measure_policies(bench, _RULE)
    quantities |= policies["quantities"]
    return {
        "about": ABOUT,
        "quantities": quantities,
        "ratios": ratios,
        "by_terrain": policies["by_terrain"],
        "missing": policies["missing"],
    }


def _play(bench: Benchmark, scene: str, substep: float) -> list[Row]:
    """Play an episode from each start."""
    changes = {"terrain": scene, "sim.substep": substep}
    env = FlipperEnv(config=with_overrides(bench.config.environment(), changes))
    policy = PolicySource.of_plugin(bench.settings.controller, "bench.controller").build(env.config)
    s = bench.settings
    seeds = EvaluationSeeds.of(s.seed, env.config.terrain).first(s.starts)
    return [play(env, policy, seed) for seed in seeds]


def _variations(rows: Sequence[Row], key: str) -> list[float | None]:
    """Return θ̂_R of each start [rad]; None where the finish was not reached."""
    return [row[key] if row["outcome"] == "reached" else None for row in rows]
