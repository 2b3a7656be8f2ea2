"""The training loop: act → step → store → update, with validation and checkpoints.

In: a validated configuration and an empty run directory, or one to go on in. Out: the files of
``design``: config.yaml, metrics.csv, events, checkpoints, summary.json.

A full checkpoint is taken between episodes only: there the world holds no state, so a resumed
run repeats the uninterrupted one bit for bit.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.replay import Replay
from flipperctl.agent.schedules import linear
from flipperctl.api import ACTIONS, Outcome
from flipperctl.config import TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.run import checkpoint
from flipperctl.run.files import write_json
from flipperctl.run.policy import QPolicy
from flipperctl.run.records import Listener
from flipperctl.run.rollout import play
from flipperctl.run.seeds import episode_seed
from flipperctl.run.statistics import reached

RECENT = 100
"""Episodes over which the running success rate is taken."""


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
        self.env = FlipperEnv(config=config.environment())
        self._validation_env = FlipperEnv(config=config.environment())
        init, explore, sample = np.random.SeedSequence(config.seed).spawn(3)
        self.agent = D3qn(
            config.network,
            self.env.layout,
            len(ACTIONS),
            agent,
            seed=int(init.generate_state(1)[0]),
            device=config.device,
        )
        self.replay = Replay(agent.replay_size, self.env.layout.size, agent.n_step, agent.gamma)
        self._generators = {
            "explore": np.random.default_rng(explore),
            "sample": np.random.default_rng(sample),
        }
        self.decision = 0
        self.episode = 0
        self.loss = 0.0
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
        try:
            while self.decision < every.decisions and not stop():
                started = self.decision
                self._episode()
                if self.decision // every.validate_every > started // every.validate_every:
                    self._validate()
                if self.decision // every.checkpoint_every > started // every.checkpoint_every:
                    self.save()
            finished = self.decision >= every.decisions
            if finished and (not self.validations or self.last_validated != self.decision):
                self._validate()
            self.save()
            summary = self.summary(finished)
            write_json(self.directory / "summary.json", summary)
            return summary
        finally:
            for listener in self.listeners:
                listener.close()

    @property
    def last_validated(self) -> int:
        """The decision of the last validation; 0 before the first."""
        return int(self.validations[-1]["decision"]) if self.validations else 0

    def _episode(self) -> None:
        config, env, replay = self.config, self.env, self.replay
        agent = config.agent
        explore, sample = self._generators["explore"], self._generators["sample"]
        seed = episode_seed("training", config.seed, self.episode)
        observation, _ = env.reset(seed=seed)
        over = False
        info: dict[str, Any] = {}
        while not over and self.decision < config.train.decisions:
            action = self.agent.act(observation, self.epsilon, explore)
            following, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            goes_on = over and info["outcome"] in agent.bootstrap_outcomes
            replay.add(observation, action, reward, following, over=over, bootstrap=goes_on)
            observation = following
            self.decision += 1
            if self.decision >= agent.learning_starts and self.decision % agent.update_every == 0:
                batch = replay.sample(agent.batch_size, sample)
                self.loss = self.agent.update(batch, self.decision / config.train.decisions)
        if not over:  # the budget ended first
            replay.drop_pending()
            return
        self.episode += 1
        self.recent.append(info["outcome"] == Outcome.REACHED)
        row = {"seed": seed, "outcome": str(info["outcome"]), **info["metrics"]}
        self._tell("episode", row)

    def _validate(self) -> None:
        settings = self.config.train
        policy = QPolicy(self.agent.policy)
        rows = [
            play(
                self._validation_env,
                policy,
                episode_seed("validation", settings.validation_seed, index),
            )
            for index in range(settings.validation_episodes)
        ]
        good = reached(rows)
        names = [n for n, v in rows[0].items() if isinstance(v, float | int) and n != "seed"]
        # Means over the episodes that reached the finish, as the paper measures; of all, if none.
        means = {n: float(np.mean([row[n] for row in good or rows])) for n in names}
        row = {"success_rate": len(good) / len(rows), **means}
        previous = self.best
        self.validations.append({"decision": self.decision, **row})
        if previous is None or _score(self.validations[-1]) > _score(previous):
            document = checkpoint.describe(
                self.config, "best", decision=self.decision, validation=self.validations[-1]
            )
            tensors = {f"policy.{k}": v for k, v in self.agent.policy.state_dict().items()}
            checkpoint.write(self.directory / checkpoint.BEST, document, tensors)
        self._tell("validation", row)

    def _tell(self, event: str, row: dict[str, Any]) -> None:
        now = {
            "decision": self.decision,
            "episode": self.episode,
            "epsilon": self.epsilon,
            "loss": self.loss,
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
            "seconds": round(self.seconds, 1),
            "success_rate": sum(self.recent) / max(1, len(self.recent)),
            "best": self.best,
            "last": self.validations[-1] if self.validations else None,
        }

    def save(self) -> None:
        """Write ``last.safetensors``: everything that training needs to go on."""
        self.seconds = time.perf_counter() - self._clock
        state = {
            "decision": self.decision,
            "episode": self.episode,
            "loss": self.loss,
            "recent": list(self.recent),
            "validations": self.validations,
            "seconds": self.seconds,
            "replay_added": self.replay.added,
            "generators": {n: g.bit_generator.state for n, g in self._generators.items()},
        }
        tensors = self.agent.tensors()
        for name, array in self.replay.filled().items():
            tensors[f"replay.{name}"] = torch.from_numpy(array)
        document = checkpoint.describe(self.config, "last", state=state)
        checkpoint.write(self.directory / checkpoint.LAST, document, tensors)

    def restore(self, saved: checkpoint.Checkpoint) -> None:
        """Take back what ``save`` wrote."""
        state = saved.document["state"]
        self.agent.restore(saved.tensors)
        arrays = {name: tensor.numpy() for name, tensor in saved.part("replay").items()}
        self.replay.restore(arrays, state["replay_added"])
        for name, generator in self._generators.items():
            generator.bit_generator.state = state["generators"][name]
        self.decision, self.episode = state["decision"], state["episode"]
        self.loss, self.seconds = state["loss"], state["seconds"]
        self.recent.extend(state["recent"])
        self.validations = state["validations"]


def _score(validation: dict[str, Any]) -> tuple[float, float]:
    return validation["success_rate"], -validation["pitch_variation"]
