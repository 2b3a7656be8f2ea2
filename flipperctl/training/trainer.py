"""The training loop: act → step → store → learn, with validations and checkpoints.

When the budget is spent, the rest of the running episodes is not learnt from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flipperctl import checkpoint
from flipperctl.agent.contract import check_demand
from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.learner import join
from flipperctl.agent.policy_gradient import PolicyGradient
from flipperctl.api import ACTIONS, Listener
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import Generators, RequestState, State
from flipperctl.config import TrainConfig
from flipperctl.env.privileged import SIZE
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.rollout.collect import Collector
from flipperctl.rollout.episode import RolloutRequest, Row
from flipperctl.training.base import BaseTrainer, Stop, closer
from flipperctl.training.episodes import (
    EpisodeSource,
    TrainingRecorder,
    ValueTargets,
    arrays,
    new_replay,
    run_arrays,
    store,
)
from flipperctl.training.recorded import add_recorded
from flipperctl.training.starting import FinalFit, start


class Trainer(BaseTrainer):
    """A run of our own learners."""

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        super().__init__(config, directory, listeners)
        layout, agent = self.env.layout, config.agent
        privileged = SIZE if config.learns_privileged_value else 0
        check_demand(
            *(config.network, layout, len(ACTIONS), agent, config.train.decisions),
            labelled=config.keeps_distributions,
            privileged=privileged,
        )
        init, explore, sample, again = np.random.SeedSequence(config.seed).spawn(4)
        seed = int(init.generate_state(1)[0])
        self.agent: D3qn | PolicyGradient = (PolicyGradient if agent.is_policy_gradient else D3qn)(
            *(config.network, layout, agent),
            seed=seed,
            device=config.device,
            teacher=config.teacher if config.teacher.teaches else None,
            privileged=privileged,
        )
        self.replay = new_replay(config, layout, privileged)
        self.valued = ValueTargets(config.teacher)
        self._final_fit = FinalFit(config, layout, self.replay, (seed, again), self._report)
        exploring, self._sample_rng = np.random.default_rng(explore), np.random.default_rng(sample)
        self._generators = {"explore": exploring, "sample": self._sample_rng}
        self._generators["noise"] = self.agent.noise_rng
        self.episodes = EpisodeSource(config, self.agent, self.progress, exploring, self._report)
        self._validating(self.agent)
        self._outstanding: list[RolloutRequest] = []
        self._recorder = TrainingRecorder(config, directory)
        self._idle_share: float | None = None

    def summary(self, finished: bool) -> dict[str, Any]:
        """Return the results of the run, with the share of time in which its workers waited."""
        idle = {} if self._idle_share is None else {"workers_idle": round(self._idle_share, 3)}
        return super().summary(finished) | idle

    def _exploring(self) -> tuple[float, int]:
        return self.episodes.epsilon, self.episodes.lag

    def _run(self, stop: Stop, opened: ExitStack) -> bool:
        if not self._restored:  # else the checkpoint has what follows
            self._recorder.restore(0)
            self._final_fit.begin(start(self.config, self.agent))
            add_recorded(self.replay, self.config, self._report)
        self._save_all(self._outstanding)
        collector = self.episodes.start_collector(self._outstanding, stop, self.replay.kept)
        opened.push(closer(collector))
        finished = self._train(collector, stop)
        self._idle_share = collector.idle_share()
        self._save_all(collector.outstanding())
        self._recorder.finish()
        return finished

    def _train(self, collector: Collector, stop: Stop) -> bool:
        """Train and validate; return whether the budget is spent, False if the run was stopped.

        A run that was stopped in a validation, or while it learnt all labels anew, repeats that
        first when it is resumed.
        """
        settings, progress = self.config.train, self.progress
        while True:
            over = progress.decision >= settings.decisions
            if self._validation_due():
                if over and not self._final_fit.run(self.agent, stop):
                    return False
                if not self._validate(collector):
                    return False
                self._save_all(collector.outstanding())
            if over:
                return True
            if stop():
                return False
            before = progress.decision
            self._train_episode(collector)
            passed = progress.decision // settings.checkpoint_every
            if passed > before // settings.checkpoint_every and not self._validation_due():
                self._save_all(collector.outstanding())

    def _train_episode(self, collector: Collector) -> None:
        """Collect, store and learn until the episode or the budget ends.

        Does nothing if the run is to stop before an episode arrives.
        """
        ending: Row | None = None
        for step in collector.episode():
            ending = step.ending
            store(self.replay, step, self.config)
            self.valued.add(step)
            self._recorder.add(step, self.progress.episode)
            self.progress.decision += 1
            self._learn_from_replay()
            if self.progress.decision >= self.config.train.decisions:
                break
        if ending is None:  # the budget ended first, or the run is to stop
            if self.config.agent.is_policy_gradient:  # the next one would seem to be its rest
                self.replay.take_back()
            self.replay.drop_pending()
            self._recorder.drop()
        else:
            self._end_episode(ending)
            self._learn_from_episodes()

    def _learn_from_replay(self) -> None:
        """Update from random transitions, every few decisions.

        No update is due before the first transition, complete after ``n_step`` decisions.
        """
        agent, progress, rng = self.config.agent, self.progress, self._sample_rng
        together = agent.updates_together
        due = progress.decision % (agent.update_every * together) == 0
        begun = progress.decision + self.replay.kept >= agent.learning_starts
        if isinstance(self.agent, D3qn) and due and begun and len(self.replay):
            batch = self.replay.sample(self.agent.candidates * together * agent.batch_size, rng)
            valued = self.valued.batches(together, rng)
            fraction = progress.decision / self.config.train.decisions
            progress.loss = self.agent.update(batch, fraction, valued)
            progress.updates += together

    def _learn_from_episodes(self) -> None:
        """Update from the newest whole episodes, each used once, if enough decisions are new."""
        agent, replay, progress = self.agent, self.replay, self.progress
        if not isinstance(agent, PolicyGradient):
            return
        new = replay.added - agent.learnt
        if new > replay.capacity:  # one episode is longer than a whole round
            raise ConfigError(
                f"agent.replay_size: {replay.capacity:,} decisions are fewer than the {new:,} of "
                "whole episodes that the policy gradient learns from at once; raise it"
            )
        if new >= self.config.agent.policy_gradient.decisions:
            fraction = progress.decision / self.config.train.decisions
            progress.loss = agent.update(replay.newest(new), fraction, self._sample_rng)
            agent.learnt = replay.added
            progress.updates += 1

    def save(self, outstanding: Sequence[RolloutRequest] = ()) -> None:
        """Write ``last.safetensors``: all that the run needs to be resumed.

        New recorded episodes are written first, so that the checkpoint counts no missing one. A
        resumed run resends the ``outstanding`` requests.
        """
        self._recorder.save()
        parts = {"replay": self.replay.filled(), "groups": self.valued.memory.filled()}
        parts |= {f"weights{request.version}": dict(request.weights) for request in outstanding}
        held = {p: {n: torch.from_numpy(a) for n, a in kept.items()} for p, kept in parts.items()}
        tensors = self.agent.tensors() | self._final_fit.tensors() | join(held)
        generators = {n: g.bit_generator.state for n, g in self._generators.items()}
        requests = [
            RequestState(**{name: getattr(request, name) for name in RequestState.model_fields})
            for request in outstanding
        ]
        state = self._state(
            orders=tuple(requests),
            replay_added=self.replay.added,
            replay_kept=self.replay.kept,
            groups_added=self.valued.memory.added,
            generators=Generators.model_validate(generators),
        )
        document = checkpoint.describe(self.config, "last", state=state)
        self._write_last(document, tensors)

    def _save_all(self, outstanding: Sequence[RolloutRequest]) -> None:
        self.save(outstanding)
        self._save_best()

    def _policy(self) -> Mapping[str, Mapping[str, torch.Tensor]]:
        networks = {"policy": self.agent.policy.state_dict()}
        if self.agent.risk is not None:
            networks["risk"] = self.agent.risk.network.state_dict()
        return networks

    def _restore(self, saved: Checkpoint, state: State) -> None:
        replay, weights = run_arrays(saved, state, self.agent, self.replay)
        self.agent.restore(saved.tensors, state.updates)
        self.replay.restore(replay, state.replay_added, state.replay_kept)
        size = self.replay.arrays["observation"].shape[1]
        try:
            self.valued.memory.restore(arrays(saved, "groups"), state.groups_added, size)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part groups is not valid: {error}") from error
        self._final_fit.restore(saved)
        for name, generator in state.generators.model_dump().items():
            self._generators[name].bit_generator.state = generator
        self._outstanding = [
            RolloutRequest(**request.model_dump(), weights=weights[request.version])
            for request in state.orders
        ]
        self._recorder.restore(state.episode)
