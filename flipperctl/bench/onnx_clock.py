"""Time the decisions of an exported policy; ``latency`` runs this in a separate process.

    python -m flipperctl.bench.onnx_clock POLICY CALLS SEED

Print one JSON document: median and 99th percentile of a decision [µs], and the heavy packages that
the process has imported (none on a robot).
"""

from __future__ import annotations

import sys
import time

from flipperctl import entry
from flipperctl.errors import MissingExtraError, RequestError

HEAVY = ("torch", "pymunk", "hydra", "gymnasium", "matplotlib")
_WARM_UP = 100


def main(path: str, calls: int, seed: int) -> dict[str, object]:
    """Time ``calls`` decisions on observations of uneven ground, on which few policies warn.

    Raises:
        MissingExtraError: ONNX Runtime is not installed.
    """
    import importlib  # here and below, where Ctrl-C already ends the process without a traceback

    try:
        runtime = importlib.import_module("flipperctl.runtime.policy")
    except ImportError as error:
        raise MissingExtraError(
            f"decisions of an exported policy: {error}; install flipperctl[robot]"
        ) from error
    import numpy as np

    policy = runtime.OnnxPolicy(path)
    rng = np.random.default_rng(seed)
    observations = rng.uniform(-0.1, 0.1, (256, policy.interface.size)).astype(
        np.float32
    )  # [m, rad]
    took = np.empty(calls)
    for index in range(-_WARM_UP, calls):
        observation = observations[index % len(observations)]
        begun = time.perf_counter_ns()
        policy.act(observation)
        took[max(index, 0)] = (time.perf_counter_ns() - begun) / 1e3
    median, p99 = np.quantile(took, (0.5, 0.99))
    imported = [name for name in HEAVY if name in sys.modules]
    return {"median": float(median), "p99": float(p99), "imported": imported}


def _main(words: list[str]) -> int:
    import json
    import shlex

    try:
        path, calls, seed = words
        numbers = int(calls), int(seed)
    except ValueError as error:
        raise RequestError(
            f"a policy, a number of calls and a seed are allowed, as in stair.onnx 1000 0; "
            f"got {shlex.join(words) or 'nothing'}"
        ) from error
    print(json.dumps(main(path, *numbers)))
    return 0


if __name__ == "__main__":
    entry.stop_at_once()
    entry.run(lambda: _main(sys.argv[1:]))
