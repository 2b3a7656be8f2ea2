"""The episodes of a training run: their seeds, the difficulty of their terrain, their collector."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from flipperctl import plugins
from flipperctl.agent.learner import Learner, arrays
from flipperctl.config import TrainConfig, to_dict
from flipperctl.config.agent import linear
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import controller_notes
from flipperctl.rollout.actor import teacher_of, training_policy
from flipperctl.rollout.collect import (
    AsyncCollector,
    Collector,
    InProcessCollector,
    RayWorkers,
    RolloutWorkers,
)
from flipperctl.rollout.pool import Stop
from flipperctl.rollout.seeds import training_seed
from flipperctl.rollout.steps import RolloutRequest, Step, Weights, steps
from flipperctl.training.saving import Progress


class EpisodeSource:
    """Starts the collector of a run and requests its episodes in the order of their seeds."""

    def __init__(
        self,
        config: TrainConfig,
        agent: Learner,
        progress: Progress,
        rng: np.random.Generator,
        report: Callable[[str], None],
    ) -> None:
        """``rng`` chooses the random actions of episodes in this process.

        ``report`` is called with sentences about the workers and the teacher for the user.
        """
        self._config, self._agent, self._progress = config, agent, progress
        self._rng, self._report = rng, report
        self._weights: tuple[int, Weights] | None = None
        self.lag = 0
        """Decisions of the run between the request of the last episode and its arrival."""

    @property
    def epsilon(self) -> float:
        """Probability of a random action at the present decision."""
        s = self._config.agent
        return linear(s.epsilon_start, s.epsilon_end, self._progress.decision / s.epsilon_decisions)

    def start_collector(
        self, outstanding: Sequence[RolloutRequest], stop: Stop, recorded: int = 0
    ) -> Collector:
        """Start the collector; resend the ``outstanding`` requests of a resumed run.

        ``recorded``: decisions of ``teacher.episodes``, which count among those before the first
        update, and so before the student drives.

        ``stop`` can end its waits and its evaluations.
        """
        config = self._config
        if (teacher := config.teacher.controller) is not None:
            for note in controller_notes(teacher, config, "teacher.controller"):
                self._report(note)
        starts = max(1, config.agent.learning_starts - recorded)
        if config.train.mode == "exact":
            return self._in_process_collector(stop, starts)
        begun = config.agent.model_copy(update={"learning_starts": starts})
        document = to_dict(config.model_copy(update={"agent": begun}))
        paths, ray = plugins.configured_paths(), config.collector
        workers = (
            RayWorkers(ray, document, paths, self._report)
            if ray.name == "ray"
            else RolloutWorkers(config.train.workers, document, paths)
        )
        for request in outstanding:
            workers.send(request)
        return AsyncCollector(workers, self._next_request, self._on_lost, self._accept, stop)

    def _in_process_collector(self, stop: Stop, starts: int) -> Collector:
        config, agent, progress = self._config, self._agent, self._progress
        env = FlipperEnv(config=config.environment())
        policy = training_policy(
            *(config, agent.online, teacher_of(config), lambda: self.epsilon),
            temperature=lambda: config.temperature_at(progress.decision),
            learns=lambda: progress.decision >= starts,
            rngs=(self._rng, agent.noise_rng),
        )
        frames, privileged = config.network.frames, config.learns_privileged_value

        def play() -> Iterator[Step]:
            return steps(
                *(env, policy, self._next_seed()),
                difficulty=progress.difficulty,
                frames=frames,
                privileged=privileged,
            )

        return InProcessCollector(play, stop)

    def _next_seed(self) -> int:
        self._progress.started += 1
        return training_seed(self._config.seed, self._progress.started - 1)

    def _next_request(self) -> RolloutRequest:
        progress = self._progress
        if self._weights is None or self._weights[0] != progress.updates:
            self._weights = (progress.updates, arrays(self._agent.online))
        version, weights = self._weights
        return RolloutRequest(
            episode=progress.started,
            seed=self._next_seed(),
            epsilon=self.epsilon,
            decision=progress.decision,
            version=version,
            weights=weights,
            difficulty=progress.difficulty,
        )

    def _on_lost(self, request: RolloutRequest) -> None:
        self._progress.lost += 1
        self._report(f"a worker died and is replaced; its episode {request.episode} is dropped")

    def _accept(self, request: RolloutRequest) -> bool:
        self.lag = self._progress.decision - request.decision
        collector = self._config.collector
        return collector.name != "ray" or self.lag <= collector.max_lag
