"""The cost of large recorded ground.

``python -m tests.long.large_ground`` prints, for recordings of 50 m, the number of points after
thinning, and the seconds and the memory that loading and driving two episodes take beyond start-up.
``--whole`` measures without thinning.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl import plugins
from flipperctl.api import Controller
from flipperctl.config import resolver
from flipperctl.env import flipper_env
from flipperctl.env.flipper_env import FlipperEnv

COUNTS = (20_000, 200_000, 1_000_000)
LENGTH = 50.0  # [m]


def rough(count: int, length: float, grain: float, seed: int = 0) -> np.ndarray:
    """Return waves of 6 m to 3 cm and white noise of ``grain`` [m] on top, (count, 2) [m]."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, length, count)
    z = rng.normal(0.0, grain, count)
    for wave, height in ((6, 0.12), (2.3, 0.06), (0.9, 0.03), (0.31, 0.012), (0.1, 0.004)):
        z += height * np.sin(2 * np.pi * x / wave + rng.uniform(0, 6))
    return np.column_stack([x, z - z[0]])


def memory() -> float:
    """Return the most memory that this process has held so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def drive(env: FlipperEnv, controller: str, seed: int) -> dict[str, Any]:
    """Return the metrics of one episode."""
    rule = resolver.create("controller", controller, "controller")
    assert isinstance(rule, Controller)
    env.reset(seed=seed)
    while True:
        *_, terminated, truncated, info = env.step(rule.act(env.perception))
        if terminated or truncated:
            return {"outcome": info["outcome"].value, **info["metrics"]}


def measure(file: str) -> dict[str, Any]:
    """Load the recording and drive two episodes on it."""
    plugins.load()
    drive(FlipperEnv("flat"), "okada", 0)  # the first episode of a process takes longer
    before, begin, busy = memory(), time.perf_counter(), time.process_time()
    env = FlipperEnv({"name": "profile_file", "path": file})
    ends = [drive(env, "okada", seed)["outcome"] for seed in range(2)]
    seconds, busy = time.perf_counter() - begin, time.process_time() - busy
    return {
        "points": len(env.profile.points),
        "seconds": round(seconds, 2),
        "of_processor": round(busy, 2),
        "MB": round(memory() - before),
        "outcomes": ends,
    }


def main(arguments: list[str]) -> None:
    """Print one line of JSON for each measurement."""
    if arguments[:1] == ["--child"]:
        if "--whole" in arguments:
            flipper_env.thinned = lambda profile, radius: profile
            flipper_env.check_extent = lambda profile: None
        print(json.dumps(measure(arguments[1])))
        return
    whole = [word for word in arguments if word == "--whole"]
    counts = [int(word) for word in arguments if word.isdigit()] or COUNTS
    with tempfile.TemporaryDirectory() as folder:
        for count in counts:
            file = Path(folder) / f"{count}.csv"
            points = rough(count, LENGTH, grain=2e-4)
            np.savetxt(file, points, delimiter=",", header="x,z", comments="", fmt="%.6f")
            child = [sys.executable, "-m", "tests.long.large_ground", "--child", str(file), *whole]
            done = subprocess.run(child, capture_output=True, text=True, check=True)
            print(json.dumps({"count": count, **json.loads(done.stdout)}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
