"""The training loop: collect → store → update, with validation and checkpoints.

In: a validated configuration and an empty run directory, or one to go on in. Out: checkpoints and
summary.json; config.yaml is the command line's, metrics.csv and events are the listeners'.

A full checkpoint is taken between episodes: there the world holds no state, so a resumed run
repeats the uninterrupted one bit for bit. The first is taken before the first decision, so that a
run can go on whenever it was killed. At the end of the budget the episode that runs is dropped
first; going on from there with a larger budget is a run of its own.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flipperctl import checkpoint, plugins
from flipperctl.agent.d3qn import D3qn, arrays
from flipperctl.agent.demand import check_demand
from flipperctl.agent.frames import input_size
from flipperctl.agent.replay import Replay
from flipperctl.agent.schedules import linear
from flipperctl.api import ACTIONS, Outcome
from flipperctl.checkpoint.document import RECENT, Generators, OrderState, State, Validation
from flipperctl.config import TrainConfig, container
from flipperctl.env import ground
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.statistics import reached
from flipperctl.files import write_json
from flipperctl.policies.exploring import ExploringPolicy
from flipperctl.policies.trained import QPolicy
from flipperctl.rollout.collect import Collector, Crew, InProcess, Order, Pipelined, Weights
from flipperctl.rollout.episode import Row, play
from flipperctl.rollout.processes import ProcessCrew
from flipperctl.rollout.seeds import episode_seed
from flipperctl.training import timing
from flipperctl.training.events import Listener
from flipperctl.training.tensors import run_arrays


class Trainer:
    """One training run.

    All that changes while it runs is saved by ``save`` and taken back by ``restore``.
    """

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        torch.set_num_threads(config.train.threads)
        self.config = config
        self.directory = directory
        self.listeners = list(listeners)
        agent = config.agent
        self._validation_env = FlipperEnv(config=config.environment())
        layout = self._validation_env.layout
        check_demand(config.network, layout, len(ACTIONS), agent, config.train.decisions)
        init, explore, sample = np.random.SeedSequence(config.seed).spawn(3)
        self.agent = D3qn(
            config.network,
            layout,
            len(ACTIONS),
            agent,
            seed=int(init.generate_state(1)[0]),
            device=config.device,
        )
        size = input_size(config.network, layout)
        self.replay = Replay(agent.replay_size, size, agent.n_step, agent.gamma)
        self._generators = {
            "explore": np.random.default_rng(explore),
            "sample": np.random.default_rng(sample),
            "noise": self.agent.noise_rng,
        }
        self.decision = 0
        self.episode = 0
        self.started = 0
        """Episodes begun or ordered; each has a seed of its own."""
        self.lost = 0
        """Episodes whose worker died."""
        self.difficulty = ground.first_difficulty(config.terrain)
        """Of the terrain in the next episode that begins or is ordered."""
        self.updates = 0
        self.loss = 0.0
        self._lag = 0
        self._weights: tuple[int, Weights] | None = None
        self._resumed: list[Order] = []
        self.recent: deque[bool] = deque(maxlen=RECENT)
        self.validations: list[dict[str, Any]] = []
        self.seconds = 0.0
        self._clock = time.perf_counter()

    @property
    def best(self) -> dict[str, Any] | None:
        """The best validation so far: by success, then by θ̂_R."""
        return max(self.validations, key=_score, default=None)

    @property
    def epsilon(self) -> float:
        """Share of random actions now."""
        s = self.config.agent
        return linear(s.epsilon_start, s.epsilon_end, self.decision / s.epsilon_decisions)

    def run(self, stop: Callable[[], bool] = lambda: False) -> dict[str, Any]:
        """Train until the budget is spent or ``stop`` says so between episodes.

        Returns the summary, which is also in ``summary.json``.
        """
        every = self.config.train
        self._clock = time.perf_counter() - self.seconds
        self._save(self._resumed)
        collector = self._collector()
        try:
            while self.decision < every.decisions and not stop():
                started = self.decision
                self._episode(collector)
                validate = self.decision // every.validate_every > started // every.validate_every
                if validate:
                    self._validate(collector)
                due = self.decision // every.checkpoint_every > started // every.checkpoint_every
                if validate or due:
                    self._save(collector.outstanding())
            finished = self.decision >= every.decisions
            if finished and (not self.validations or self.last_validated != self.decision):
                self._validate(collector)
            self._save(collector.outstanding())
            summary = self.summary(finished)
            write_json(self.directory / "summary.json", summary)
            return summary
        finally:
            collector.close()
            for listener in self.listeners:
                listener.close()

    @property
    def last_validated(self) -> int:
        """The decision of the last validation; 0 before the first."""
        return int(self.validations[-1]["decision"]) if self.validations else 0

    def _collector(self) -> Collector:
        config = self.config
        if config.train.mode == "exact":
            env = FlipperEnv(config=config.environment())
            frames = config.network.frames
            policy = ExploringPolicy(
                self.agent.online,
                frames,
                lambda: self.epsilon,
                self._generators["explore"],
                self._generators["noise"],
            )
            return InProcess(env, policy, self._next_seed, lambda: self.difficulty, frames)
        document, paths = container(config), plugins.configured_paths()
        crew: Crew
        if config.collector.name == "ray":
            from flipperctl.rollout.ray_workers import RayCrew

            crew = RayCrew(config.collector, document, paths)
        else:
            crew = ProcessCrew(config.train.workers, document, paths)
        collector = Pipelined(crew, self._order, self._worker_died, self._in_time)
        collector.resume(self._resumed)
        return collector

    def _next_seed(self) -> int:
        self.started += 1
        return episode_seed("training", self.config.seed, self.started - 1)

    def _order(self) -> Order:
        if self._weights is None or self._weights[0] != self.updates:
            self._weights = (self.updates, arrays(self.agent.online))
        episode = self.started
        seed = self._next_seed()
        version, weights = self._weights
        return Order(episode, seed, self.epsilon, self.decision, version, weights, self.difficulty)

    def _worker_died(self, order: Order) -> None:
        self.lost += 1
        for listener in self.listeners:
            listener.note(f"a worker died and is replaced; its episode {order.episode} is dropped")

    def _in_time(self, order: Order) -> bool:
        self._lag = self.decision - order.decision
        collector = self.config.collector
        return collector.name != "ray" or self._lag <= collector.max_lag

    def _episode(self, collector: Collector) -> None:
        config, replay, agent = self.config, self.replay, self.config.agent
        sample, together = self._generators["sample"], agent.updates_together
        period = agent.update_every * together
        ending: Row | None = None
        for step in collector.episode():
            ending = step.ending
            goes_on = ending is not None and ending["outcome"] in agent.bootstrap_outcomes
            replay.add(
                step.observation,
                step.action,
                step.reward,
                step.following,
                over=ending is not None,
                bootstrap=goes_on,
            )
            self.decision += 1
            if self.decision >= agent.learning_starts and self.decision % period == 0:
                batch = replay.sample(together * agent.batch_size, sample)
                self.loss = self.agent.update(batch, self.decision / config.train.decisions)
                self.updates += together
            if self.decision >= config.train.decisions:
                break
        if ending is None:  # the budget ended first
            replay.drop_pending()
            return
        self.episode += 1
        success = ending["outcome"] == Outcome.REACHED
        self.recent.append(success)
        self.difficulty = ground.next_difficulty(config.terrain, self.difficulty, success)
        self._tell("episode", {"lag": self._lag, **ending})

    def _validate(self, collector: Collector) -> None:
        settings = self.config.train
        stream = [
            episode_seed("validation", settings.validation_seed, index)
            for index in range(settings.validation_episodes)
        ]

        def own(seeds: Sequence[int]) -> list[Row]:
            with self.agent.judged() as module:
                policy = QPolicy(module, self.config.network.frames)
                return [play(self._validation_env, policy, seed) for seed in seeds]

        rows = collector.judge(arrays(self.agent.policy), stream, own)
        good = reached(rows)
        names = [n for n, v in rows[0].items() if isinstance(v, float | int) and n != "seed"]
        # Means over the episodes that reached the finish, as the paper measures; of all, if none.
        means = {n: float(np.mean([row[n] for row in good or rows])) for n in names}
        row = {"success_rate": len(good) / len(rows), **means}
        self.validations.append({"decision": self.decision, **row})
        self._tell("validation", row)

    def _save(self, orders: Sequence[Order]) -> None:
        """Write ``last.safetensors``, then ``best.safetensors`` if the policy is the best so far.

        In this order, no best is ever of a decision that the run, once killed and resumed, may
        not come to; and a resumed run writes the best that it was killed before.
        """
        self.save(orders)
        best = self.best
        if best is None or best["decision"] != self.decision:
            return
        document = checkpoint.describe(self.config, "best", decision=self.decision, validation=best)
        tensors = {f"policy.{k}": v for k, v in self.agent.policy.state_dict().items()}
        checkpoint.write(self.directory / checkpoint.BEST, document, tensors)

    def _tell(self, event: str, row: dict[str, Any]) -> None:
        now = {
            "decision": self.decision,
            "episode": self.episode,
            "epsilon": self.epsilon,
            "loss": self.loss if self.updates else None,
            "seconds": round(time.perf_counter() - self._clock, 3),
        }
        if event == "episode":
            now["success_rate"] = sum(self.recent) / len(self.recent)
        for listener in self.listeners:
            getattr(listener, event)({**now, **row})

    def summary(self, finished: bool) -> dict[str, Any]:
        """What became of the run."""
        self.seconds = time.perf_counter() - self._clock
        config = self.config
        return {
            "finished": finished,
            "terrain": config.terrain.plugin_name,
            "network": config.network.plugin_name,
            "seed": config.seed,
            "decisions": self.decision,
            "episodes": self.episode,
            "lost_episodes": self.lost,
            "seconds": round(self.seconds, 1),
            "success_rate": sum(self.recent) / max(1, len(self.recent)),
            "best": self.best,
            "last": self.validations[-1] if self.validations else None,
        }

    def save(self, orders: Sequence[Order] = ()) -> None:
        """Write ``last.safetensors``: everything that training needs to go on.

        ``orders`` are outstanding: a resumed run gives them again.
        """
        self.seconds = time.perf_counter() - self._clock
        generators = {n: g.bit_generator.state for n, g in self._generators.items()}
        state = State(
            decision=self.decision,
            episode=self.episode,
            loss=self.loss,
            recent=tuple(self.recent),
            validations=tuple(Validation(**row) for row in self.validations),
            started=self.started,
            lost=self.lost,
            updates=self.updates,
            difficulty=self.difficulty,
            orders=tuple(
                OrderState(**{name: getattr(order, name) for name in OrderState.model_fields})
                for order in orders
            ),
            replay_added=self.replay.added,
            generators=Generators.model_validate(generators),
        )
        tensors = self.agent.tensors()
        for name, array in self.replay.filled().items():
            tensors[f"replay.{name}"] = torch.from_numpy(array)
        for version, weights in {order.version: order.weights for order in orders}.items():
            for name, array in weights.items():
                tensors[f"weights{version}.{name}"] = torch.from_numpy(array)
        document = checkpoint.describe(self.config, "last", state=state)
        checkpoint.write(self.directory / checkpoint.LAST, document, tensors)
        timing.write(self.directory, self.seconds)

    def restore(self, saved: checkpoint.Checkpoint) -> None:
        """Take back what ``save`` wrote.

        Raises:
            CheckpointError: it is of an earlier version, or its tensors are not those of this run.
        """
        state = saved.document.state
        if state is None:
            raise CheckpointError(
                f"{saved.path} is of an earlier version: its policy can be judged and exported, "
                "but the run cannot go on"
            )
        replay, weights = run_arrays(saved, state, self.agent, self.replay)
        self.agent.restore(saved.tensors, state.updates)
        self.replay.restore(replay, state.replay_added)
        for name, generator in state.generators.model_dump().items():
            self._generators[name].bit_generator.state = generator
        self.decision, self.episode = state.decision, state.episode
        self.started, self.lost = state.started, state.lost
        self.updates = state.updates
        self.difficulty, self.loss = state.difficulty, state.loss
        self.seconds = timing.read(self.directory)
        self._resumed = [Order(**o.model_dump(), weights=weights[o.version]) for o in state.orders]
        self.recent.extend(state.recent)
        self.validations = [validation.model_dump() for validation in state.validations]


def _score(validation: dict[str, Any]) -> tuple[float, float]:
    return validation["success_rate"], -validation["pitch_variation"]
