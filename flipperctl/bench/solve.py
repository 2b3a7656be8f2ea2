"""Time to solve: from the start until every unseen episode succeeds, three validations in a row.

Our trainer with its configuration against Stable-Baselines3's DQN with the best settings found
for it (see ``sb3``), on the same environment, validated on exactly the same episodes after as
many decisions, with the same budget of decisions. Seeds in turn: ours, theirs, ours, …
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

from flipperctl import checkpoint
from flipperctl.bench.attempt import Attempt, Listens
from flipperctl.bench.extras import extra
from flipperctl.bench.settings import Bench, BenchSettings
from flipperctl.bench.spread import quantity, ratio
from flipperctl.config import TrainConfig, with_overrides
from flipperctl.errors import MissingExtraError
from flipperctl.training.trainer import Trainer

ABOUT = (
    "wall-clock from the start, validations included, until all unseen episodes of several "
    "validations in a row succeed; training is the same without the time of the validations"
)


def measure(bench: Bench) -> dict[str, Any]:
    """Seconds and decisions until solved, seed by seed; None for a run that did not solve it."""
    contestants: dict[str, Callable[[TrainConfig, Attempt, Callable[[], None]], None]]
    contestants, missing = {"flipperctl": ours}, []
    details: dict[str, Any] = {}
    try:
        sb3 = extra("flipperctl.bench.sb3", "stable-baselines3", "bench")
        contestants["sb3"], details["sb3_settings"] = sb3.solve, sb3.SETTINGS
    except MissingExtraError as error:
        missing.append(str(error))
    s = bench.settings
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in contestants}
    threads = torch.get_num_threads()
    total = s.seeds * len(contestants)
    try:
        for seed in range(s.seed + 1, s.seed + 1 + s.seeds):
            for name, run in contestants.items():
                config = configured(bench, seed)
                attempt = Attempt(seed, s)
                done = sum(map(len, runs.values()))
                run(config, attempt, _teller(bench, attempt, name, done, total))
                runs[name].append(attempt.report())
    finally:
        torch.set_num_threads(threads)
    return {"about": ABOUT, **summary(runs, s), **details, "missing": missing}


def summary(runs: Mapping[str, list[dict[str, Any]]], s: BenchSettings) -> dict[str, Any]:
    """Quantities and ratios (theirs over ours) of the runs' reports."""
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


def configured(bench: Bench, seed: int) -> TrainConfig:
    """The training configuration of one run."""
    s = bench.settings
    changes = {
        "seed": seed,
        "train.validate_every": s.validate_every,
        "train.validation_episodes": s.validation_episodes,
    }
    return with_overrides(bench.config, changes)


def ours(config: TrainConfig, attempt: Attempt, tell: Callable[[], None]) -> None:
    """Our trainer, until the attempt is over."""

    def stop() -> bool:
        tell()
        return attempt.over

    with TemporaryDirectory(prefix="flipperctl-bench-") as folder:
        directory = Path(folder)
        (directory / checkpoint.BEST).parent.mkdir()
        Trainer(config, directory, [Listens(attempt)]).run(stop)


def _teller(bench: Bench, attempt: Attempt, name: str, done: int, total: int) -> Callable[[], None]:
    def tell() -> None:
        share = min(1.0, attempt.elapsed / attempt.settings.limit)
        last = attempt.validations[-1]["success_rate"] if attempt.validations else 0.0
        text = f"{name}, seed {attempt.seed}: {attempt.elapsed:.0f} s, success {last:.0%}"
        bench.tell(text, (done + share) / total)

    return tell
