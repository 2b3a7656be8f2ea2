"""One run of a learner until it solves the task: clock, validations and termination."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from benchmarks.settings import BenchmarkSettings
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.rows import reached
from flipperctl.policies.trained import TrainedPolicy
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import validation_seed


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


class ValidationRecorder:
    """Listen to a trainer and add its validations to a run.

    The trainer validates right after an episode, so a validation lasts from then on.
    """

    def __init__(self, run: SolveRun) -> None:
        self._run = run
        self._last = run.elapsed

    def episode(self, row: Mapping[str, Any]) -> None:
        """Note the time at which a training episode ended."""
        self._last = self._run.elapsed

    def validation(self, row: Mapping[str, Any]) -> None:
        """Add a validation that has just ended."""
        took = self._run.elapsed - self._last
        self._run.add_validation(int(row["decision"]), row["success_rate"], took)

    def note(self, text: str) -> None:
        """Ignore the text."""

    def close(self) -> None:
        """Release nothing."""


class Validation:
    """Validate another learner's policy on the trainer's validation episodes."""

    def __init__(self, config: TrainConfig) -> None:
        self._env = FlipperEnv(config=config.environment())
        self._seed = config.train.validation_seed
        self._episodes = config.train.validation_episodes

    def __call__(self, module: torch.nn.Module) -> float:
        """Return the success rate, the fraction of episodes that reach the finish [-]."""
        policy = TrainedPolicy(module)
        seeds = (validation_seed(self._seed, i) for i in range(self._episodes))
        return sum(reached(play(self._env, policy, seed)) for seed in seeds) / self._episodes
