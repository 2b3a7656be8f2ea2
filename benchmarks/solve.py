"""Time from the start until every unseen episode succeeds in three validations in a row.

flipperctl's trainer with its configuration is compared with Stable-Baselines3's DQN with the best
settings found for it (see ``sb3``). Both have the same environment and budget of decisions and are
validated on the same episodes after equal numbers of decisions. They run in turn for each seed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from benchmarks.settings import MISSING, Benchmark, BenchmarkSettings, quantity, ratio
from flipperctl import checkpoint
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.training.trainer import Trainer

ABOUT = (
    "wall-clock from the start, validations included, until all unseen episodes of several "
    "validations in a row succeed; training is that time without validations"
)


@dataclass
class SolveRun:
    """The validations of one run; its clock starts at construction."""

    seed: int
    settings: BenchmarkSettings
    validations: list[dict[str, float]] = field(default_factory=list)
    """``decision``, ``seconds`` since the start and ``success_rate`` of each validation."""
    validation_seconds: float = 0.0
    """Time spent in validations [s]."""
    started: float = field(default_factory=lambda: time.perf_counter())
    """Reading of the performance counter at the start [s]."""

    @property
    def elapsed(self) -> float:
        """Time since the start of the run [s]."""
        return time.perf_counter() - self.started

    @property
    def solved(self) -> bool:
        """Whether every episode of the required number of last validations succeeded."""
        wanted = self.settings.in_a_row
        last = self.validations[-wanted:]
        return len(last) == wanted and all(v["success_rate"] == 1.0 for v in last)

    @property
    def finished(self) -> bool:
        """Whether the task is solved or the time limit is exceeded."""
        return self.solved or self.elapsed > self.settings.limit

    def add_validation(self, decision: int, success_rate: float, took: float) -> None:
        """Add a validation that has just ended and took ``took`` [s]."""
        if self.finished:
            return
        self.validation_seconds += took
        self.validations.append(
            {"decision": decision, "seconds": self.elapsed, "success_rate": success_rate}
        )

    def report(self) -> dict[str, Any]:
        """Return the run as plain data; if unsolved, its times and decisions are None."""
        last = self.validations[-1] if self.solved else None
        return {
            "seed": self.seed,
            "solved": self.solved,
            "seconds": last and last["seconds"],
            "training_seconds": last and last["seconds"] - self.validation_seconds,
            "decisions": last and last["decision"],
            "validations": self.validations,
        }


class _Recorder:
    """Listen to a trainer, which validates right after an episode, and add its validations."""

    def __init__(self, run: SolveRun) -> None:
        self._run = run
        self._last = run.elapsed

    def episode(self, row: Mapping[str, Any]) -> None:
        self._last = self._run.elapsed

    def validation(self, row: Mapping[str, Any]) -> None:
        took = self._run.elapsed - self._last
        self._run.add_validation(int(row["decision"]), row["success_rate"], took)

    def note(self, text: str) -> None:
        pass

    def close(self) -> None:
        pass


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure time [s] and decisions until solved for each seed; None for an unsolved run."""
    contestants: dict[str, Callable[[TrainConfig, SolveRun, Callable[[], None]], None]]
    contestants, missing = {"flipperctl": solve}, []
    details: dict[str, Any] = {}
    try:
        from benchmarks import sb3

        contestants["sb3"], details["sb3_settings"] = sb3.solve, sb3.SETTINGS
    except ImportError:
        missing.append(MISSING)
    s = bench.settings
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in contestants}
    threads = torch.get_num_threads()
    total = s.seeds * len(contestants)
    try:
        for seed in range(s.seed + 1, s.seed + 1 + s.seeds):
            changes = {
                "seed": seed,
                "train.validate_every": s.validate_every,
                "train.validation_episodes": s.validation_episodes,
            }
            config = with_overrides(bench.config, changes)
            for name, solver in contestants.items():
                run = SolveRun(seed, s)
                done = sum(map(len, runs.values()))
                solver(config, run, _reporter(bench, run, name, done, total))
                runs[name].append(run.report())
    finally:
        torch.set_num_threads(threads)
    unfinished = f"not within {s.limit:g} s"
    found = {**summary(runs, s), **details, "unfinished": unfinished, "missing": missing}
    return {"about": ABOUT, **found}


def summary(runs: Mapping[str, list[dict[str, Any]]], s: BenchmarkSettings) -> dict[str, Any]:
    """Return quantities and ratios (other learners over flipperctl) of the runs' reports."""
    units = {"seconds": "s", "training_seconds": "s", "decisions": "-"}
    values = {(n, what): [r[what] for r in found] for n, found in runs.items() for what in units}
    return {
        "criterion": f"{s.in_a_row} validations in a row, each {s.validation_episodes} of "
        f"{s.validation_episodes} unseen episodes, one every {s.validate_every} decisions",
        "limit": {"unit": "s", "value": s.limit},
        "solved": {
            n: f"{sum(r['solved'] for r in found)} of {s.seeds}" for n, found in runs.items()
        },
        "quantities": {f"{n}.{what}": quantity(v, units[what]) for (n, what), v in values.items()},
        "ratios": {
            f"{name} / flipperctl, {what}": ratio(values[name, what], values["flipperctl", what])
            for name in runs
            if name != "flipperctl"
            for what in units
        },
        "runs": dict(runs),
    }


def solve(config: TrainConfig, run: SolveRun, report: Callable[[], None]) -> None:
    """Train with flipperctl's trainer until the run is finished."""

    def stop() -> bool:
        report()
        return run.finished

    with TemporaryDirectory(prefix="flipperctl-bench-") as folder:
        directory = Path(folder)
        (directory / checkpoint.BEST).parent.mkdir()
        Trainer(config, directory, [_Recorder(run)]).run(stop)


def _reporter(
    bench: Benchmark, run: SolveRun, name: str, done: int, total: int
) -> Callable[[], None]:
    def report() -> None:
        fraction = min(1.0, run.elapsed / run.settings.limit)
        last = run.validations[-1]["success_rate"] if run.validations else 0.0
        text = f"{name}, seed {run.seed}: {run.elapsed:.0f} s, success {last:.0%}"
        bench.report_progress(text, (done + fraction) / total)

    return report
