"""One attempt at solving the task: its clock, its validations, and when it is over."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from flipperctl.bench.settings import BenchSettings
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.statistics import success_rate
from flipperctl.policies.trained import TrainedPolicy
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import episode_seed


@dataclass
class Attempt:
    """One run, while it goes on and afterwards. Its clock starts when it is made."""

    seed: int
    settings: BenchSettings
    validations: list[dict[str, float]] = field(default_factory=list)
    """``decision``, ``seconds`` since the start, ``success_rate``."""
    validating: float = 0.0
    """Time spent in validations [s]."""
    begun: float = field(default_factory=lambda: time.perf_counter())

    @property
    def elapsed(self) -> float:
        """Time since the start [s]."""
        return time.perf_counter() - self.begun

    @property
    def solved(self) -> bool:
        """The last validations were all perfect."""
        wanted = self.settings.in_a_row
        last = self.validations[-wanted:]
        return len(last) == wanted and all(v["success_rate"] == 1.0 for v in last)

    @property
    def over(self) -> bool:
        """Solved, or out of time."""
        return self.solved or self.elapsed > self.settings.limit

    def validated(self, decision: int, success_rate: float, took: float) -> None:
        """Note a validation that has just ended and took so long [s]."""
        if self.over:
            return
        self.validating += took
        self.validations.append(
            {"decision": decision, "seconds": self.elapsed, "success_rate": success_rate}
        )

    def report(self) -> dict[str, Any]:
        """The run as plain data; ``seconds`` are None if it was not solved."""
        last = self.validations[-1] if self.solved else None
        return {
            "seed": self.seed,
            "solved": self.solved,
            "seconds": last and last["seconds"],
            "training_seconds": last and last["seconds"] - self.validating,
            "decisions": last and last["decision"],
            "validations": self.validations,
        }


class Listens:
    """Tells an attempt of the trainer's validations.

    The trainer validates straight after an episode, so the time since that is the validation's.
    """

    def __init__(self, attempt: Attempt) -> None:
        self._attempt = attempt
        self._last = attempt.elapsed

    def episode(self, row: Mapping[str, Any]) -> None:
        """A training episode ended."""
        self._last = self._attempt.elapsed

    def validation(self, row: Mapping[str, Any]) -> None:
        """A validation ended."""
        took = self._attempt.elapsed - self._last
        self._attempt.validated(int(row["decision"]), row["success_rate"], took)

    def note(self, text: str) -> None:
        """Not this one's business."""

    def close(self) -> None:
        """The run ended."""


class Validation:
    """The trainer's validation, for a policy of another learner."""

    def __init__(self, config: TrainConfig) -> None:
        self._env = FlipperEnv(config=config.environment())
        self._seed = config.train.validation_seed
        self._episodes = config.train.validation_episodes

    def __call__(self, module: torch.nn.Module) -> float:
        """Return the fraction of the episodes that reach the finish, 0 to 1."""
        policy = TrainedPolicy(module)
        seeds = (episode_seed("validation", self._seed, i) for i in range(self._episodes))
        return success_rate([play(self._env, policy, seed) for seed in seeds])
