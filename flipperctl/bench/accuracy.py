"""Accuracy by the simulator's substep: θ̂_R on the paper's scenes compared with finer substeps.

The same controller crosses the same scene from several starts at each substep.
"""

from __future__ import annotations

from typing import Any

from flipperctl.api import SAMPLE_PERIOD
from flipperctl.bench.settings import Bench
from flipperctl.bench.statistics import quantity, ratio
from flipperctl.config import resolver, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import episode_seed
from flipperctl.sim.planar import planar

ABOUT = (
    "θ̂_R of a rule on the paper's scenes, from several starts, by substep; ratios against a "
    "quarter of the configured substep"
)
SCENES = ("paper_step", "paper_stair")
FACTORS = (2.0, 1.0, 0.5, 0.25)
"""Substeps as multiples of the configured one [-]; the last one is the reference."""


def measure(bench: Bench) -> dict[str, Any]:
    """Measure θ̂_R [rad] by scene and substep [ms], and its ratio to that of the finest substep."""
    # The sample period is the coarsest substep that the simulator accepts.
    substeps = [f * planar(bench.config.sim).substep for f in FACTORS]
    substeps = [step for step in substeps if step <= SAMPLE_PERIOD * (1 + 1e-9)]
    runs = [(scene, step) for scene in SCENES for step in substeps]
    found: dict[tuple[str, float], list[float | None]] = {}
    for index, (scene, step) in enumerate(runs):
        bench.report_progress(f"{scene} at {1e3 * step:g} ms", index / len(runs))
        found[scene, step] = variations(bench, scene, step)
    names = {(scene, step): f"{scene}.{1e3 * step:g}ms" for scene, step in runs}
    finest = substeps[-1]
    return {
        "about": ABOUT,
        "quantities": {names[run]: quantity(values, "rad") for run, values in found.items()},
        "ratios": {
            f"{names[scene, step]} / {names[scene, finest]}": ratio(values, found[scene, finest])
            for (scene, step), values in found.items()
            if step != finest
        },
        "missing": [],
    }


def variations(bench: Bench, scene: str, substep: float) -> list[float | None]:
    """Return θ̂_R of each start [rad]; None where the finish was not reached."""
    changes = {"terrain": scene, "sim.substep": substep}
    env = FlipperEnv(config=with_overrides(bench.config.environment(), changes))
    policy = resolver.create("controller", bench.settings.controller, "bench.controller").build()
    s = bench.settings
    seeds = (episode_seed("evaluation", s.seed, index) for index in range(s.starts))
    rows = [play(env, policy, seed) for seed in seeds]
    return [r["pitch_variation"] if r["outcome"] == "reached" else None for r in rows]
