"""The training loop: act → step → store → learn, with validations and checkpoints.

In: a validated configuration and an empty run directory, or one to go on in. Out: checkpoints and
summary.json; config.yaml is the command line's, metrics.csv and events are the listeners'.

The first checkpoint is taken before the first decision, so that a run can go on whenever it was
killed. At the end of the budget the episode that runs is dropped; going on from there with a larger
budget is a run of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.demand import check_demand
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS, Outcome
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import Validation
from flipperctl.config import TrainConfig
from flipperctl.env import ground
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.files import write_json
from flipperctl.rollout.collect import Collector
from flipperctl.rollout.episode import Row
from flipperctl.rollout.values import RolloutRequest, Step
from flipperctl.training.episodes import EpisodeSource
from flipperctl.training.events import Listener
from flipperctl.training.progress import Progress
from flipperctl.training.saving import RunSaver
from flipperctl.training.timing import Stopwatch
from flipperctl.training.validation import Validator


class Trainer:
    """One training run."""

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        torch.set_num_threads(config.train.threads)
        self.config, self.directory = config, directory
        self.listeners = list(listeners)
        env = FlipperEnv(config=config.environment())
        layout, agent = env.layout, config.agent
        check_demand(config.network, layout, len(ACTIONS), agent, config.train.decisions)
        init, explore, sample = np.random.SeedSequence(config.seed).spawn(3)
        seed = int(init.generate_state(1)[0])
        self.agent = D3qn(
            config.network, layout, len(ACTIONS), agent, seed=seed, device=config.device
        )
        size = input_size(config.network, layout)
        self.replay = Replay(agent.replay_size, size, agent.n_step, agent.gamma)
        generators = {
            "explore": np.random.default_rng(explore),
            "sample": np.random.default_rng(sample),
            "noise": self.agent.noise_rng,
        }
        self._sample = generators["sample"]
        self.progress = Progress(ground.first_difficulty(config.terrain))
        self.episodes = EpisodeSource(
            config, self.agent, self.progress, generators["explore"], self._note_loss
        )
        self.validator = Validator(config, self.agent, env)
        history = self.validator.history
        self._saver = RunSaver(
            config, directory, self.agent, self.replay, self.progress, generators, history
        )
        self._stopwatch = Stopwatch(directory)
        self._outstanding: list[RolloutRequest] = []

    def run(self, stop: Callable[[], bool] = lambda: False) -> dict[str, Any]:
        """Train until the budget is spent or ``stop`` asks for the end between episodes.

        Returns the summary, which is also in ``summary.json``.
        """
        every, progress = self.config.train, self.progress
        self._stopwatch.start()
        self._save_all(self._outstanding)
        collector = self.episodes.open(self._outstanding)
        try:
            while progress.decision < every.decisions and not stop():
                before = progress.decision
                self._train_episode(collector)
                validate = self._passed(before, every.validate_every)
                if validate:
                    self._validate(collector)
                if validate or self._passed(before, every.checkpoint_every):
                    self._save_all(collector.outstanding())
            finished = progress.decision >= every.decisions
            last = self.validator.last
            if finished and (last is None or last.decision != progress.decision):
                self._validate(collector)
            self._save_all(collector.outstanding())
            summary = self.summary(finished)
            write_json(self.directory / "summary.json", summary)
            return summary
        finally:
            collector.close()
            for listener in self.listeners:
                listener.close()

    def _passed(self, before: int, period: int) -> bool:
        """Whether a multiple of ``period`` lies between ``before`` and the decision now."""
        return self.progress.decision // period > before // period

    def _train_episode(self, collector: Collector) -> None:
        """Act and step in the collector, store, learn; until the episode or the budget ends."""
        ending: Row | None = None
        for step in collector.episode():
            ending = step.ending
            self._store(step)
            self.progress.decision += 1
            self._learn()
            if self.progress.decision >= self.config.train.decisions:
                break
        if ending is None:  # the budget ended first
            self.replay.drop_pending()
        else:
            self._end_episode(ending)

    def _store(self, step: Step) -> None:
        ending, bootstrapped = step.ending, self.config.agent.bootstrap_outcomes
        self.replay.add(
            step.observation,
            step.action,
            step.reward,
            step.next_observation,
            over=ending is not None,
            bootstrap=ending is not None and ending["outcome"] in bootstrapped,
        )

    def _learn(self) -> None:
        """Update the agent when it is time to."""
        agent, progress = self.config.agent, self.progress
        together = agent.updates_together
        due = progress.decision % (agent.update_every * together) == 0
        if progress.decision >= agent.learning_starts and due:
            batch = self.replay.sample(together * agent.batch_size, self._sample)
            progress.loss = self.agent.update(
                batch, progress.decision / self.config.train.decisions
            )
            progress.updates += together

    def _end_episode(self, ending: Row) -> None:
        reached = ending["outcome"] == Outcome.REACHED
        self.progress.episode += 1
        self.progress.recent.append(reached)
        self.episodes.ended(reached)
        row = {**self._now(), "success_rate": self.progress.success_rate}
        for listener in self.listeners:
            listener.episode({**row, "lag": self.episodes.lag, **ending})

    def _validate(self, collector: Collector) -> None:
        found = self.validator.validate(collector, self.progress.decision)
        means = found.model_dump(exclude={"decision"})
        for listener in self.listeners:
            listener.validation({**self._now(), **means})

    def _note_loss(self, request: RolloutRequest) -> None:
        text = f"a worker died and is replaced; its episode {request.episode} is dropped"
        for listener in self.listeners:
            listener.note(text)

    def _now(self) -> dict[str, Any]:
        """What every row of ``metrics.csv`` says of the run."""
        progress = self.progress
        return {
            "decision": progress.decision,
            "episode": progress.episode,
            "epsilon": self.episodes.epsilon,
            "loss": progress.loss if progress.updates else None,
            "seconds": round(self._stopwatch.seconds, 3),
        }

    def save(self, outstanding: Sequence[RolloutRequest] = ()) -> None:
        """Write ``last.safetensors``: everything that training needs to go on."""
        self._saver.save(outstanding)
        self._stopwatch.write()

    def _save_all(self, outstanding: Sequence[RolloutRequest]) -> None:
        """Write ``last.safetensors``, then ``best.safetensors`` if the policy is the best so far.

        In this order, no best is ever of a decision that the run, once killed and resumed, may
        not come to; and a resumed run writes the best that it was killed before.
        """
        self.save(outstanding)
        best = self.validator.best
        if best is not None and best.decision == self.progress.decision:
            self._saver.save_best(best)

    def restore(self, saved: Checkpoint) -> None:
        """Take back what ``save`` wrote.

        Raises:
            CheckpointError: it is of an earlier version, or its tensors are not those of this run.
        """
        self._outstanding = self._saver.restore(saved)
        self._stopwatch.read()

    def summary(self, finished: bool) -> dict[str, Any]:
        """Return what became of the run, as plain data."""
        config, progress = self.config, self.progress
        return {
            "finished": finished,
            "terrain": config.terrain.plugin_name,
            "network": config.network.plugin_name,
            "seed": config.seed,
            "decisions": progress.decision,
            "episodes": progress.episode,
            "lost_episodes": progress.lost,
            "seconds": round(self._stopwatch.seconds, 1),
            "success_rate": progress.success_rate,
            "best": _plain(self.validator.best),
            "last": _plain(self.validator.last),
        }


def _plain(validation: Validation | None) -> dict[str, Any] | None:
    return None if validation is None else validation.model_dump()
