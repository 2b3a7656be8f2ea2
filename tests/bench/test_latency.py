"""Decisions of an exported policy, checkpoints, memory."""

import subprocess
import sys
from dataclasses import replace

import pytest

from flipperctl.bench import latency
from flipperctl.bench import settings as process
from flipperctl.config import with_overrides
from flipperctl.errors import FlipperctlError, MissingExtraError
from tests.bench.small import check, small_bench


@pytest.mark.long
def test_times_and_memory_have_their_units() -> None:
    bench = small_bench()
    exact = {"train.mode": "exact"}  # in one process, which does not import torch anew
    found = latency.measure(
        replace(
            bench,
            config=with_overrides(bench.config, exact),
            # The short training has a budget of its own, whatever the user's is.
            overrides=("train.decisions=1000", *(f"{key}={v}" for key, v in exact.items())),
        )
    )
    check(found)
    units = {name: q["unit"] for name, q in found["quantities"].items()}
    assert units["checkpoint_write"] == units["checkpoint_read"] == units["onnx_export"] == "ms"
    assert units["training_peak_memory"] == "MiB"
    (peak,) = found["quantities"]["training_peak_memory"]["values"]
    assert 50 < peak < 4000  # torch alone holds more than the one, no laptop the other
    if not found["missing"]:
        assert found["imported"] == []
        q = found["quantities"]
        assert q["decision_median"]["median"] <= q["decision_p99"]["median"]
        assert units["decision_median"] == units["decision_p99"] == "µs"


def test_the_clock_imports_neither_torch_nor_pymunk() -> None:
    code = f"import sys, {latency.CLOCK} as c; print([n for n in c.HEAVY if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_process_that_fails_says_why() -> None:
    code = "import sys; print('first'); sys.exit('out of paper')"
    with pytest.raises(FlipperctlError, match="printing failed: out of paper"):
        process.output([sys.executable, "-c", code], "printing")
    wanting = "import sys; print('install flipperctl[robot]', file=sys.stderr); sys.exit(2)"
    with pytest.raises(MissingExtraError):
        process.output([sys.executable, "-c", wanting], "printing")
