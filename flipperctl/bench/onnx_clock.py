"""Time the decisions of an exported policy; ``latency`` runs this in a process of its own.

    python -m flipperctl.bench.onnx_clock POLICY CALLS SEED

It prints one JSON document: median and 99th percentile of a decision [µs], and the heavy packages
that the process has imported (none on a robot).
"""

from __future__ import annotations

import importlib
import json
import sys
import time

import numpy as np

from flipperctl.errors import FlipperctlError, MissingExtraError

HEAVY = ("torch", "pymunk", "hydra", "gymnasium", "matplotlib")
_WARM_UP = 100


def main(path: str, calls: int, seed: int) -> dict[str, object]:
    """Time ``calls`` decisions on random observations of plausible magnitude.

    Raises:
        MissingExtraError: ONNX Runtime is not installed.
    """
    try:
        runtime = importlib.import_module("flipperctl.runtime")
    except ImportError as error:
        raise MissingExtraError(
            f"decisions of an exported policy: {error}; install flipperctl[robot]"
        ) from error
    policy = runtime.OnnxPolicy(path)
    rng = np.random.default_rng(seed)
    observations = rng.uniform(-0.5, 0.5, (256, policy.interface.size)).astype(np.float32)
    took = np.empty(calls)
    for index in range(-_WARM_UP, calls):
        observation = observations[index % len(observations)]
        begun = time.perf_counter_ns()
        policy.act(observation)
        took[max(index, 0)] = (time.perf_counter_ns() - begun) / 1e3
    median, p99 = np.quantile(took, (0.5, 0.99))
    imported = [name for name in HEAVY if name in sys.modules]
    return {"median": float(median), "p99": float(p99), "imported": imported}


if __name__ == "__main__":
    try:
        print(json.dumps(main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))))
    except FlipperctlError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
