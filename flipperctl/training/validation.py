"""Validation: evaluates the policy on the same episodes each time and finds the best policy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from flipperctl.agent.learner import Learner
from flipperctl.checkpoint.document import BestBy, Validation
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.metrics import DRAWN
from flipperctl.evaluation.rows import reached
from flipperctl.reward_sum import paying_terms
from flipperctl.rollout.collect import Collector
from flipperctl.rollout.greedy import GreedyPlayer
from flipperctl.rollout.seeds import validation_seed
from flipperctl.training.calibrating import calibrated

_BEST_BY: Final[dict[str, BestBy]] = {
    "success": "pitch_variation_100hz",
    "return": "return",
    "last": "decision",
}


class Validator:
    """Validates the agent's policy and keeps the results."""

    def __init__(self, config: TrainConfig, agent: Learner, env: FlipperEnv) -> None:
        self._agent, self._learner = agent, config.agent
        self._greedy = GreedyPlayer(config, env)
        settings = config.train
        self._seeds = [
            validation_seed(settings.validation_seed, index)
            for index in range(settings.validation_episodes)
        ]
        self.history: list[Validation] = []
        """Results of all validations, oldest first."""
        self._paying = [f"reward_{name}" for name in paying_terms(config.rewards)]
        self._configured: BestBy = _BEST_BY[settings.best_by]
        self.best_by: BestBy = self._configured
        """What ranks the validations."""

    @property
    def best(self) -> Validation | None:
        """Best validation so far by ``best_by``."""
        return max(self.history, key=lambda v: v.score(self.best_by), default=None)

    def restore(self, history: Sequence[Validation], best_by: BestBy) -> None:
        """Continue after the validations of a resumed run.

        A run that has chosen a best policy, as by θ̂_R at decisions in earlier versions, goes on
        choosing in that way: with another one the best could be one whose weights are lost.
        """
        self.history[:] = history
        self.best_by = best_by if history else self._configured

    @property
    def last(self) -> Validation | None:
        """Newest validation."""
        return self.history[-1] if self.history else None

    def validate(self, collector: Collector, decision: int) -> Validation | None:
        """Play all episodes, which the collector distributes; return and keep the result.

        ``decision``: number of decisions of the run so far. Returns None if the run is to stop
        before the last episode has ended.
        """
        weights = self._agent.policy_arrays()
        self._greedy.load(weights)
        rows = collector.evaluate(weights, self._seeds, self._greedy.play)
        if rows is None:
            return None
        reached_rows = [row for row in rows if reached(row)]
        risk = calibrated(rows, self._learner)
        numbers = [n for n, v in rows[0].items() if isinstance(v, float | int) and n != "seed"]
        names = [n for n in numbers if not n.startswith(DRAWN)]  # parts of a mix draw others
        # Means over the episodes that reached the finish, as in the paper; over all if none did.
        averaged = reached_rows or rows
        means = {name: float(np.mean([row[name] for row in averaged])) for name in names}
        success = len(reached_rows) / len(rows)
        returns = [sum(float(row[name]) for name in self._paying) for row in rows]
        self.history.append(
            Validation(
                decision=decision,
                success_rate=success,
                mean_return=float(np.mean(returns)),
                **means,
                **({} if risk is None else risk[1]),
            )
        )
        return self.history[-1]
