"""When a training updates its learner, and from what.

In: the replay, after each decision and after each episode. Out: updates of the learner, counted in
the progress of the run.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.policy_gradient import PolicyGradient
from flipperctl.agent.replay import Replay
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.training.progress import Progress
from flipperctl.training.valued import ValuedStates


class Updates(Protocol):
    """Updates of a learner."""

    def after_decision(self) -> None:
        """Update the learner if an update is due at this decision."""

    def after_episode(self) -> None:
        """Update the learner if an update is due after an episode that has ended."""

    def after_cut(self) -> None:
        """Forget what must not be learnt from an episode that the end of the budget has cut."""


class ReplayUpdates:
    """Updates from random transitions, every few decisions."""

    def __init__(
        self,
        config: TrainConfig,
        agent: D3qn,
        replay: Replay,
        valued: ValuedStates,
        progress: Progress,
        rng: np.random.Generator,
    ) -> None:
        """``rng`` draws the transitions."""
        self._config, self._agent, self._replay = config, agent, replay
        self._valued, self._progress, self._rng = valued, progress, rng

    def after_decision(self) -> None:
        """Update the agent if an update is due at this decision.

        No update is due before the first transition, complete after ``n_step`` decisions.
        """
        agent, progress = self._config.agent, self._progress
        together = agent.updates_together
        due = progress.decision % (agent.update_every * together) == 0
        begun = progress.decision + self._replay.kept >= agent.learning_starts
        if due and begun and len(self._replay):
            batch = self._replay.sample(together * agent.batch_size, self._rng)
            valued = self._valued.batches(together, self._rng)
            fraction = progress.decision / self._config.train.decisions
            progress.loss = self._agent.update(batch, fraction, valued)
            progress.updates += together

    def after_episode(self) -> None:
        """Do nothing."""

    def after_cut(self) -> None:
        """Do nothing: its complete transitions are as good as others."""


class EpisodeUpdates:
    """Updates from the newest whole episodes, each of which is used once."""

    def __init__(
        self,
        config: TrainConfig,
        agent: PolicyGradient,
        replay: Replay,
        progress: Progress,
        rng: np.random.Generator,
    ) -> None:
        """``rng`` shuffles the transitions."""
        self._config, self._agent, self._replay = config, agent, replay
        self._progress, self._rng = progress, rng

    def after_decision(self) -> None:
        """Do nothing: an episode must have ended."""

    def after_episode(self) -> None:
        """Update the agent if enough decisions are new."""
        agent, replay, progress = self._agent, self._replay, self._progress
        new = replay.added - agent.learnt
        if new > replay.capacity:  # one episode is longer than a whole round
            raise ConfigError(
                f"agent.replay_size: {replay.capacity:,} decisions are fewer than the {new:,} of "
                "whole episodes that the policy gradient learns from at once; raise it"
            )
        if new >= self._config.agent.policy_gradient.decisions:
            fraction = progress.decision / self._config.train.decisions
            progress.loss = agent.update(replay.newest(new), fraction, self._rng)
            agent.learnt = replay.added
            progress.updates += 1

    def after_cut(self) -> None:
        """Remove the part of the episode: another one would follow as if it were its rest."""
        self._replay.take_back()
