"""Where a run's episodes come from: their seeds, their terrain's difficulty, who plays them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from flipperctl import plugins
from flipperctl.agent.d3qn import D3qn, arrays
from flipperctl.agent.schedules import linear
from flipperctl.config import TrainConfig, container
from flipperctl.env import ground
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.exploring import ExploringPolicy
from flipperctl.rollout.collect import AsyncCollector, Collector, InProcessCollector, RolloutWorkers
from flipperctl.rollout.processes import ProcessWorkers
from flipperctl.rollout.seeds import episode_seed
from flipperctl.rollout.values import RolloutRequest, Weights
from flipperctl.training.progress import Progress


class EpisodeSource:
    """Requests episodes from whoever plays them, in the order of their seeds."""

    def __init__(
        self,
        config: TrainConfig,
        agent: D3qn,
        progress: Progress,
        rng: np.random.Generator,
        report_lost: Callable[[RolloutRequest], None],
    ) -> None:
        """``rng`` explores in this process; ``report_lost`` is called when a worker has died."""
        self._config, self._agent, self._progress = config, agent, progress
        self._rng, self._report_lost = rng, report_lost
        self._weights: tuple[int, Weights] | None = None
        self.lag = 0
        """Decisions between the request of the last episode and its arrival."""

    @property
    def epsilon(self) -> float:
        """Probability of a random action now."""
        s = self._config.agent
        return linear(s.epsilon_start, s.epsilon_end, self._progress.decision / s.epsilon_decisions)

    def open(self, outstanding: Sequence[RolloutRequest]) -> Collector:
        """Start whoever plays; ``outstanding`` requests of a resumed run are made again."""
        config = self._config
        if config.train.mode == "exact":
            return self._in_process()
        document, paths = container(config), plugins.configured_paths()
        workers: RolloutWorkers
        if config.collector.name == "ray":
            from flipperctl.rollout.ray_workers import RayWorkers

            workers = RayWorkers(config.collector, document, paths)
        else:
            workers = ProcessWorkers(config.train.workers, document, paths)
        collector = AsyncCollector(workers, self._request, self._lost, self._accept)
        collector.resume(list(outstanding))
        return collector

    def ended(self, reached: bool) -> None:
        """Let the terrain choose the difficulty of what follows an episode."""
        progress = self._progress
        terrain = self._config.terrain
        progress.difficulty = ground.next_difficulty(terrain, progress.difficulty, reached)

    def _in_process(self) -> Collector:
        env = FlipperEnv(config=self._config.environment())
        frames, agent = self._config.network.frames, self._agent
        policy = ExploringPolicy(
            agent.online, frames, lambda: self.epsilon, self._rng, agent.noise_rng
        )
        return InProcessCollector(
            env, policy, self._next_seed, lambda: self._progress.difficulty, frames
        )

    def _next_seed(self) -> int:
        self._progress.started += 1
        return episode_seed("training", self._config.seed, self._progress.started - 1)

    def _request(self) -> RolloutRequest:
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

    def _lost(self, request: RolloutRequest) -> None:
        self._progress.lost += 1
        self._report_lost(request)

    def _accept(self, request: RolloutRequest) -> bool:
        self.lag = self._progress.decision - request.decision
        collector = self._config.collector
        return collector.name != "ray" or self.lag <= collector.max_lag
