"""Speed of episodes with ``perception=lidar``: simulated time per second of CPU time.

A controller crosses steps in ``sim=mujoco``, on the true ground and with the LiDAR, by each kind of
odometry and with four times the rays. Its actions are repeated in turn by each environment, whose
whole steps are timed: physics, casting of rays, estimates, rewards. The true ground shows what of
it is not the LiDAR's.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from benchmarks.engines import Clock
from benchmarks.settings import Benchmark, quantity, ratio
from flipperctl.commands.speed import measure_in_turn
from flipperctl.config import with_overrides
from flipperctl.errors import MissingExtraError
from flipperctl.rollout.episode import EvaluationSeeds

ABOUT = (
    "simulated time per second of CPU time (× real time on one core) of the environment in 3-D, on "
    "the true ground and with a LiDAR, by odometry and by rays of a scan, in turn"
)
TRUE = "true_ground"
_MATCHED = {"name": "lidar", "pose": "matched"}
CONTESTANTS: Mapping[str, Mapping[str, Any]] = {
    TRUE: {"name": "planar"},
    "lidar.true": {"name": "lidar"},
    "lidar.belts": {"name": "lidar", "pose": "belts"},
    "lidar.matched": _MATCHED,
    "lidar.matched.28800": {**_MATCHED, "azimuths": 900},
}
"""The sensor of each contestant; a scan has 7,200 rays unless its name says another number."""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure simulated time over CPU time [-] by sensor, and ratios to the true ground."""
    s, config = bench.settings, bench.config.environment()
    clocks: dict[str, Clock] = {}
    missing: list[str] = []
    for name, sensor in CONTESTANTS.items():
        bench.report_progress(f"recording {name}", 0.0)
        one = with_overrides(config, {"sim": "mujoco", "terrain": "step", "perception": sensor})
        seeds = EvaluationSeeds.of(s.seed, one.terrain).first(s.episodes)
        try:
            clocks[name] = Clock(one, s.controller, seeds)
        except MissingExtraError as error:
            missing.append(f"{name}: {error}")
    found = measure_in_turn(
        {name: clock.environment for name, clock in clocks.items()},
        s.repeats,
        partial(bench.report_progress, "in turn"),
    )
    return {
        "about": ABOUT,
        "quantities": {name: quantity(values, "-") for name, values in found.items()},
        "ratios": {
            f"{name} / {TRUE}": ratio(values, found[TRUE])
            for name, values in found.items()
            if name != TRUE
        },
        "missing": missing,
    }
