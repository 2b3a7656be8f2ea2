"""Latency of an exported policy, and time and memory of a training on this machine.

The policy is timed in a separate process that imports neither torch nor pymunk, as on a robot.
Checkpoints and exports come from a short training with this configuration.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.settings import Benchmark, milliseconds, quantity
from flipperctl import checkpoint
from flipperctl.commands.speed import clocked, measure_in_turn, output
from flipperctl.config import with_overrides
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
    s, report = bench.settings, bench.report_progress
    own: dict[str, Any] = {
        "train.decisions": s.decisions,
        "train.validate_every": s.decisions,
        "train.validation_episodes": 1,
    }
    missing: list[str] = []
    with TemporaryDirectory(prefix="flipperctl-bench-") as name:
        folder = Path(name)
        last, best, policy = folder / checkpoint.LAST, folder / checkpoint.BEST, folder / "p.onnx"
        best.parent.mkdir()
        report("a short training", 0.0)
        trainer = Trainer(with_overrides(bench.config, own), folder)
        trainer.run()
        saved, rounds = checkpoint.read(best), []
        clocks = {
            "checkpoint_write": milliseconds(trainer.save),
            "checkpoint_read": milliseconds(lambda: checkpoint.read(last)),
            "weights_read": milliseconds(lambda: checkpoint.read(best)),
            "onnx_export": milliseconds(lambda: export(saved, policy)),
        }
        try:
            export(saved, policy)
            for done in range(s.repeats):
                report("decisions of the exported policy", 0.1 + 0.3 * done / s.repeats)
                rounds.append(clocked(policy, s.calls, s.seed))
        except MissingExtraError as error:
            del clocks["onnx_export"]
            missing.append(str(error))
        found = measure_in_turn(
            clocks, s.repeats, lambda done: report("checkpoints and export", 0.4 + 0.4 * done)
        )
        quantities = {name: quantity(values, "ms") for name, values in found.items()}
        for what in ("median", "p99") if rounds else ():
            quantities[f"decision_{what}"] = quantity([r[what] for r in rounds], "µs")
        details = {"checkpoint_size": {"unit": "B", "value": last.stat().st_size}}
        if Path("/proc/self/smaps_rollup").exists():
            report("memory of a short training", 0.8)
            own |= {"train.regret_episodes": 0, "hydra.run.dir": str(folder / "peak")}
            quantities["training_peak_memory"] = quantity([peak(bench, own)], "MiB")
        else:
            missing.append("memory is measured on Linux only")
    return {"about": ABOUT, "quantities": quantities, "ratios": {}, **details, "missing": missing}


def peak(bench: Benchmark, own: Mapping[str, object]) -> float:
    """Return the peak memory of all processes of a training with ``own`` settings [MiB]."""
    others = [word for word in bench.overrides if word.lstrip("+").partition("=")[0] not in own]
    short = [literal_override(key, str(value)) for key, value in own.items()]
    command = [sys.executable, "-m", "flipperctl", "train", *others, *short]
    peak_kib = output([sys.executable, "-S", "-c", _PEAK, *command], "latency: the short training")
    return int(peak_kib) / 1024
