"""The episodes of a training: where they come from, and the memories and files that keep them.

Out of the collector come steps; they go into the replay, the value targets and, if asked for
(``train.record``), into files from which others can learn: one with each checkpoint, of the
episodes that have ended since the previous one, and one of all when the run ends or is stopped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.agent.learner import Learner, part
from flipperctl.agent.learner import arrays as weights_of
from flipperctl.agent.replay import UNKNOWN, GroupBatch, GroupMemory, Replay
from flipperctl.api import ACTIONS, ObservationLayout, Outcome, RecordedEpisode
from flipperctl.checkpoint import Checkpoint, recording
from flipperctl.checkpoint.document import RECENT, State, require_equal_layout
from flipperctl.config import Teacher, TrainConfig
from flipperctl.config.agent import linear
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.files import make_folder
from flipperctl.guard import refusal
from flipperctl.policies.source import controller_notes
from flipperctl.rollout.collect import (
    AsyncCollector,
    Collector,
    InProcessCollector,
    RayWorkers,
    RolloutWorkers,
    teacher_of,
    training_policy,
    training_steps,
)
from flipperctl.rollout.episode import (
    EpisodeRecorder,
    RolloutRequest,
    Step,
    Weights,
    training_seed,
)
from flipperctl.rollout.pool import Stop


@dataclass
class Progress:
    """The counters of a run."""

    difficulty: float
    """Difficulty of the terrain in the next new or requested episode, 0 to 1."""
    decision: int = 0
    """Number of decisions stored for learning so far."""
    episode: int = 0
    """Number of episodes that ended."""
    started: int = 0
    """Number of episodes begun or requested; each has its own seed."""
    lost: int = 0
    """Number of episodes lost because their worker died."""
    updates: int = 0
    loss: float = 0.0
    """Loss of the last update."""
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    """Whether the last episodes reached the finish."""

    @property
    def success_rate(self) -> float:
        """Fraction of the last episodes that reached the finish; 0 before the first."""
        return sum(self.recent) / max(1, len(self.recent))


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
        update, and so before the student drives. ``stop`` can end waits and evaluations.
        """
        config = self._config
        if (teacher := config.teacher.controller) is not None:
            for note in controller_notes(teacher, config, "teacher.controller"):
                self._report(note)
        starts = max(1, config.agent.learning_starts - recorded)
        if config.train.mode == "exact":
            return InProcessCollector(self._playing_here(starts), stop)
        begun = config.agent.model_copy(update={"learning_starts": starts})
        acting, ray = config.model_copy(update={"agent": begun}), config.collector
        workers = (
            RayWorkers(ray, acting, self._report)
            if ray.name == "ray"
            else RolloutWorkers(config.train.workers, acting)
        )
        for request in outstanding:
            workers.send(request)
        return AsyncCollector(workers, self._next_request, self._on_lost, self._accept, stop)

    def _playing_here(self, starts: int) -> Callable[[], Iterator[Step]]:
        """Return a function that plays the next episode with the newest weights."""
        config, agent, progress = self._config, self._agent, self._progress
        env = FlipperEnv(config=config.environment())
        policy = training_policy(
            *(config, agent.online, teacher_of(config), lambda: self.epsilon),
            decision=lambda: progress.decision,
            starts=starts,
            rngs=(self._rng, agent.noise_rng),
        )
        return lambda: training_steps(config, env, policy, self._next_seed(), progress.difficulty)

    def _next_seed(self) -> int:
        self._progress.started += 1
        return training_seed(self._config.seed, self._progress.started - 1)

    def _next_request(self) -> RolloutRequest:
        progress = self._progress
        if self._weights is None or self._weights[0] != progress.updates:
            self._weights = (progress.updates, weights_of(self._agent.online))
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


def new_replay(config: TrainConfig, layout: ObservationLayout, privileged: int) -> Replay:
    """Return an empty replay; ``privileged``: length of a privileged state, 0 without them."""
    agent = config.agent
    return Replay(
        *(agent.replay_size, input_size(config.network, layout), agent.n_step, agent.gamma),
        labels=len(ACTIONS) if config.keeps_distributions else 0,
        privileged=privileged,
        risk_horizon=agent.risk_horizon if agent.risk else 0,
        newest=layout.size,
        cut_at_random=agent.cut_at_random,
    )


def store(replay: Replay, step: Step, config: TrainConfig) -> None:
    """Put a step into the replay."""
    ending, bootstrapped = step.ending, config.agent.bootstrap_outcomes
    replay.add(
        step.observation,
        step.action,
        step.reward,
        step.next_observation,
        over=ending is not None,
        bootstrap=ending is not None and ending["outcome"] in bootstrapped,
        explored=step.explored,
        failed=ending is not None and ending["outcome"] != Outcome.REACHED,
        label=step.label,
        privileged=step.privileged,
        next_privileged=step.next_privileged,
    )


class ValueTargets:
    """Groups of states with values, if the teacher's loss learns from them."""

    def __init__(self, teacher: Teacher) -> None:
        self._teacher = teacher
        self.memory = GroupMemory(teacher.kept_groups)

    def add(self, step: Step) -> None:
        """Store what the last step of an episode brings."""
        controller = self._teacher.controller
        if self._teacher.loss != "values" or step.ending is None or controller is None:
            return
        if step.groups is None:
            raise ConfigError(
                f"teacher.loss=values: the controller {controller.plugin_name} values no states; "
                "teacher=searched does"
            )
        states, numbers = step.groups.observations.shape[1:]
        if numbers != len(step.observation) or states != (self.memory.states or states):
            raise refusal(
                controller,
                "groups",
                f"returned groups of {states} observations of {numbers} numbers; observations of "
                f"{len(step.observation)} numbers are allowed, equally many in each group and "
                "episode",
            )
        self.memory.add(step.groups)

    def batches(self, count: int, rng: np.random.Generator) -> list[GroupBatch]:
        """Return a batch for each of ``count`` gradient steps; none without stored states."""
        if not len(self.memory):
            return []
        return [self.memory.sample(self._teacher.batch_groups, rng) for _ in range(count)]


Arrays = dict[str, NDArray[np.generic]]


def run_arrays(
    saved: Checkpoint, state: State, agent: Learner, replay: Replay
) -> tuple[Arrays, dict[int, Arrays]]:
    """Check all tensors; return the replay's arrays and the weights of the outstanding requests.

    The weights are keyed by their version.
    """
    if state.replay_kept >= replay.capacity:
        raise CheckpointError(
            f"{saved.path}: its part replay is not valid: {state.replay_kept} kept transitions "
            f"leave no room in a replay of {replay.capacity}"
        )
    own, versions = agent.tensors(), {request.version for request in state.orders}
    expected: dict[str, Mapping[str, torch.Tensor]] = {
        **{name: part(own, name) for name in dict.fromkeys(key.split(".")[0] for key in own)},
        "replay": {n: torch.from_numpy(a) for n, a in replay.blank(state.replay_added).items()},
        **{f"weights{version}": agent.online.state_dict() for version in versions},
    }
    for name, tensors in expected.items():
        try:
            require_equal_layout(saved.part(name), tensors)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part {name} is not valid: {error}") from error
    found = arrays(saved, "replay")
    bounds: dict[str, tuple[float, float]] = {
        **{"action": (0.0, len(ACTIONS) - 1), "discount": (0.0, 1), "label": (0.0, 1)},
        **{"failing": (UNKNOWN, 1), "resembles": (0.0, 1)},
    }
    for name, (least, most) in bounds.items():
        values = np.asarray(found.get(name, least), np.float64)
        if ((values < least) | (values > most)).any():
            text = f"replay.{name} lies outside of {least:g} to {most}"
            raise CheckpointError(f"{saved.path}: {text}")
    return found, {version: arrays(saved, f"weights{version}") for version in versions}


def arrays(saved: Checkpoint, part: str) -> Arrays:
    """Return the tensors of a part of a checkpoint as arrays."""
    return {name: tensor.numpy() for name, tensor in saved.part(part).items()}


EPISODES = Path("episodes.safetensors")
"""File of a run directory with all episodes of the training, written when the run ends."""
PARTS = Path("episodes")
"""Folder of a run directory with the files written with its checkpoints since the run started."""


class TrainingRecorder:
    """Writes the episodes of a training, if ``train.record`` is set, each once until the run ends.

    A file in the folder ``episodes`` is named after the number of its first episode, counted from
    0. It is written before the checkpoint that counts its episodes. Those that no checkpoint counts
    are played and written again when the run is resumed.
    """

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        self._config, self._directory = config, directory
        self._on, self._size = config.train.record, config.perception.size
        self._running, self._new = EpisodeRecorder(), list[RecordedEpisode]()

    def add(self, step: Step, number: int) -> None:
        """Add a step of episode ``number``, counted from 0."""
        if not self._on:
            return
        newest = slice(-self._size, None)  # of the frames in the network's input
        self._running.add(
            step.observation[newest],
            step.action,
            step.reward,
            step.next_observation[newest],
            step.label if self._config.teacher.teaches else None,
        )
        if step.ending is not None:
            self._new.append(self._running.finish(number, step.ending))

    def drop(self) -> None:
        """Discard the running episode."""
        self._running.drop()

    def save(self) -> None:
        """Write the episodes that have ended since the last call, completely or not at all."""
        if self._new:
            folder = make_folder(self._directory / PARTS)
            self._write(folder / f"{self._new[0].number:08}.safetensors", self._new)
            self._new = []

    def finish(self) -> None:
        """Write all episodes into one file and remove the files of the checkpoints."""
        if not self._on:
            return
        self.save()
        parts = self._parts()
        if parts or not (self._directory / EPISODES).is_file():
            self._write(self._directory / EPISODES, list(self._saved()))
        self._remove(parts)

    def restore(self, episodes: int) -> None:
        """Continue after the first ``episodes``; drop later ones, which are played again."""
        if not self._on:
            return
        whole = self._directory / EPISODES
        self._remove([path for path in self._parts() if int(path.stem) >= episodes])
        if episodes == 0:
            whole.unlink(missing_ok=True)
            return
        saved = list(self._saved())
        if saved and saved[-1].number >= episodes:  # from after the restored checkpoint
            self._write(whole, [episode for episode in saved if episode.number < episodes])
            self._remove(self._parts())

    def _parts(self) -> list[Path]:
        """Return the files of the checkpoints in the order of their episodes."""
        found = (self._directory / PARTS).glob("*.safetensors")
        return sorted((path for path in found if path.stem.isdecimal()), key=lambda p: int(p.stem))

    def _saved(self) -> Iterator[RecordedEpisode]:
        """Yield each written episode once, in order."""
        whole, last = self._directory / EPISODES, -1
        for path in [*([whole] if whole.is_file() else []), *self._parts()]:
            for episode in recording.read(path).episodes:
                if episode.number > last:  # the run may have been killed after joining it
                    last = episode.number
                    yield episode

    def _write(self, path: Path, episodes: list[RecordedEpisode]) -> None:
        driver = f"training on {self._config.terrain.plugin_name}"
        recording.write(path, driver, [(self._config, episodes)])

    def _remove(self, parts: list[Path]) -> None:
        for path in parts:
            path.unlink()
        folder = self._directory / PARTS
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
