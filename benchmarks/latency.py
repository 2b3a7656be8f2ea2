"""Latency of an exported policy, and time and memory of a training on this machine.

The policy is timed in a separate process that imports neither torch nor pymunk, as on a robot.
Checkpoints and exports come from a short training with this configuration.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.settings import Benchmark
from flipperctl import checkpoint
from flipperctl.bench import clocked, measure_in_turn, output, quantity
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.config.words import literal_override
from flipperctl.errors import MissingExtraError
from flipperctl.export.policy import export
from flipperctl.training.trainer import Trainer

ABOUT = (
    "one decision of an exported ONNX policy on one thread, in a process without torch and "
    "pymunk; writing and reading checkpoints, exporting; memory of a short training"
)

# Run a command in its own session and print the largest total memory of its processes
# [KiB]; shared memory (libraries, a fork server's pages) counts once, divided among its users.
_PEAK = """
import pathlib, subprocess, sys, time
process = subprocess.Popen(
    sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
)
def memory(entry):
    try:
        if entry.joinpath("stat").read_text().rpartition(")")[2].split()[3] != str(process.pid):
            return 0
        lines = entry.joinpath("smaps_rollup").read_text().splitlines()
        return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    except (OSError, IndexError):
        return 0
peak = 0
while process.poll() is None:
    peak = max(peak, sum(map(memory, pathlib.Path("/proc").glob("[0-9]*"))))
    time.sleep(0.1)
sys.stderr.buffer.write(process.stderr.read())
print(peak)
sys.exit(process.returncode)
"""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure decisions [µs], checkpoints and exports [ms], and memory [MiB]."""
    s = bench.settings
    missing: list[str] = []
    with TemporaryDirectory(prefix="flipperctl-bench-") as name:
        folder = Path(name)
        bench.report_progress("a short training", 0.0)
        trainer = trained(bench.config, s.decisions, folder)
        last, best = folder / checkpoint.LAST, folder / checkpoint.BEST
        saved, policy = checkpoint.read(best), folder / "policy.onnx"
        clocks: dict[str, Callable[[], float]] = {
            "checkpoint_write": _milliseconds(trainer.save),
            "checkpoint_read": _milliseconds(lambda: checkpoint.read(last)),
            "weights_read": _milliseconds(lambda: checkpoint.read(best)),
        }
        quantities = {
            n: quantity(v, "ms")
            for n, v in measure_in_turn(
                clocks, s.repeats, _part(bench, "checkpoints", 0.1, 0.2)
            ).items()
        }
        details: dict[str, Any] = {"checkpoint_size": {"unit": "B", "value": last.stat().st_size}}
        try:
            took = _milliseconds(lambda: export(saved, "onnx", policy))
            exports = measure_in_turn(
                {"e": took}, max(1, s.repeats // 3), _part(bench, "export", 0.2, 0.4)
            )
            quantities["onnx_export"] = quantity(exports["e"], "ms")
            rounds = []
            for index in range(s.repeats):
                bench.report_progress(
                    "decisions of the exported policy", 0.4 + 0.3 * index / s.repeats
                )
                rounds.append(clocked(policy, s.calls, s.seed))
            for what in ("median", "p99"):
                quantities[f"decision_{what}"] = quantity([r[what] for r in rounds], "µs")
            details["imported"] = rounds[0]["imported"]
        except MissingExtraError as error:
            missing.append(str(error))
        if Path("/proc/self/smaps_rollup").exists():
            bench.report_progress("memory of a short training", 0.8)
            quantities["training_peak_memory"] = quantity([peak(bench, folder)], "MiB")
        else:
            missing.append("memory is measured on Linux only")
    return {"about": ABOUT, "quantities": quantities, "ratios": {}, **details, "missing": missing}


def trained(config: TrainConfig, decisions: int, folder: Path) -> Trainer:
    """Train for ``decisions`` decisions; return the trainer."""
    changes = {
        "train.decisions": decisions,
        "train.validate_every": decisions,
        "train.validation_episodes": 1,
    }
    (folder / checkpoint.BEST).parent.mkdir()
    trainer = Trainer(with_overrides(config, changes), folder)
    trainer.run()
    return trainer


def peak(bench: Benchmark, folder: Path) -> float:
    """Return the peak memory of all processes of a short training together [MiB]."""
    decisions = str(bench.settings.decisions)
    own = {
        "train.decisions": decisions,
        "train.validate_every": decisions,
        "train.validation_episodes": "1",
        "train.regret_episodes": "0",
        "hydra.run.dir": str(folder / "peak"),
    }
    others = [word for word in bench.overrides if word.lstrip("+").partition("=")[0] not in own]
    short = [literal_override(key, value) for key, value in own.items()]
    command = [sys.executable, "-m", "flipperctl", "train", *others, *short]
    peak_kib = output([sys.executable, "-S", "-c", _PEAK, *command], "latency: the short training")
    return int(peak_kib) / 1024


def _milliseconds(work: Callable[[], object]) -> Callable[[], float]:
    def clock() -> float:
        begun = time.perf_counter()
        work()
        return 1e3 * (time.perf_counter() - begun)

    return clock


def _part(bench: Benchmark, what: str, low: float, high: float) -> Callable[[float], None]:
    return lambda fraction: bench.report_progress(what, low + fraction * (high - low))
