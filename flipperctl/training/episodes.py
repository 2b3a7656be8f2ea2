"""The episodes of a training: where they come from, and the files that keep them.

The collector yields steps, which go to the learner and, with ``train.record``, into files from
which others can learn. Each checkpoint adds a file of the episodes that have ended since the
previous one. When the run ends or is stopped, these files are joined into one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from flipperctl.agent.plain import PlainNetworks, Weights
from flipperctl.agent.risk import weights_of
from flipperctl.api import Learning, RecordedEpisode, Step
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.document import RECENT
from flipperctl.config import TrainConfig
from flipperctl.rollout.collect import (
    AsyncCollector,
    Collector,
    InProcessCollector,
    RayWorkers,
    RolloutWorkers,
)
from flipperctl.rollout.episode import EpisodeRecorder, RolloutRequest, training_seed
from flipperctl.rollout.pool import Stop
from flipperctl.rollout.training import ConfiguredTraining
from flipperctl.text.files import make_folder


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
        training: ConfiguredTraining,
        learning: Learning,
        progress: Progress,
        plain: PlainNetworks | None = None,
    ) -> None:
        """``plain``: what the workers drive with; None: the networks of torch."""
        self._training, self._learning, self._progress = training, learning, progress
        self._plain = plain
        self._config: TrainConfig = training.config
        self._weights: tuple[int, Weights] | None = None
        self.lag = 0
        """Decisions of the run between the request of the last episode and its arrival."""

    def start_collector(self, outstanding: Sequence[RolloutRequest], stop: Stop) -> Collector:
        """Start the collector; resend the ``outstanding`` requests of a resumed run.

        ``stop`` can end waits and evaluations.
        """
        config, training = self._config, self._training
        # A learner with a loop of its own needs a collector for its validations alone.
        if config.agent.own_loop:
            return InProcessCollector(lambda: iter(()), stop)
        if config.train.mode == "exact":
            return InProcessCollector(self._playing_here(), stop)
        ray = config.collector
        workers = (
            RayWorkers(ray, config, training.shared, training.report, self._plain)
            if ray.name == "ray"
            else RolloutWorkers(config.train.workers, config, training.shared, self._plain)
        )
        # The requests of a stopped run come first, with the weights that they had.
        for request in outstanding:
            workers.send(request)
        return AsyncCollector(workers, self._next_request, self._on_lost, self._accept, stop)

    def _playing_here(self) -> Callable[[], Iterator[Step]]:
        """Return a function that plays the next episode with the newest weights."""
        training, progress = self._training, self._progress
        env, rng = training.environment(), training.generators["explore"]
        driving = self._learning.driving
        policy = self._config.agent.drive(training, driving, lambda: progress.decision, rng)
        return lambda: training.steps(env, policy, self.next_seed(), progress.difficulty)

    def next_seed(self) -> int:
        """Return the seed of the next episode, which begins with it."""
        self._progress.started += 1
        return training_seed(self._config.seed, self._progress.started - 1)

    def _next_request(self) -> RolloutRequest:
        progress = self._progress
        # All requests between two updates share one copy of the weights.
        if self._weights is None or self._weights[0] != progress.updates:
            self._weights = (progress.updates, weights_of(self._learning.driving))
        version, weights = self._weights
        return RolloutRequest(
            episode=progress.started,
            seed=self.next_seed(),
            decision=progress.decision,
            version=version,
            weights=weights,
            difficulty=progress.difficulty,
        )

    def _on_lost(self, request: RolloutRequest) -> None:
        self._progress.lost += 1
        self._training.report(
            f"a worker died and is replaced; its episode {request.episode} is dropped"
        )

    def _accept(self, request: RolloutRequest) -> bool:
        self.lag = self._progress.decision - request.decision
        collector = self._config.collector
        return collector.name != "ray" or self.lag <= collector.max_lag


EPISODES = Path("episodes.safetensors")
"""File of a run directory with all episodes of the training, written when the run ends."""
PARTS = Path("episodes")
"""Folder of a run directory with the files written with its checkpoints since the run started."""


class TrainingRecorder:
    """Writes the episodes of a training, if ``train.record`` is set, each once until the run ends.

    A file in the folder ``episodes`` is named after the number of its first episode, counted from
    0. It is written before the checkpoint that counts its episodes. Episodes that no checkpoint
    counts are played and written again when the run is resumed.
    """

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        self._config, self._directory = config, directory
        self._on, self._size = config.train.record, config.perception.size
        self._running = EpisodeRecorder(config.robot) if self._on else None
        self._new: list[RecordedEpisode] = []

    def add(self, step: Step, number: int) -> None:
        """Add a step of episode ``number``, counted from 0."""
        if self._running is None:
            return
        assert isinstance(step.action, int)  # of such a training
        newest = slice(-self._size, None)  # of the frames in the network's input
        self._running.add(
            step.observation[newest],
            step.action,
            step.reward,
            step.next_observation[newest],
            step.label if self._config.teacher.teaches else None,
        )
        if step.ending is not None:
            self._new.append(self._running.finish(number, dict(step.ending)))

    def drop(self) -> None:
        """Discard the running episode."""
        if self._running is not None:
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
        # Join only what is new; a run without episodes gets an empty file.
        if parts or not (self._directory / EPISODES).is_file():
            self._write(self._directory / EPISODES, list(self._saved()))
        self._remove(parts)

    def restore(self, episodes: int) -> None:
        """Continue after the first ``episodes``; drop later ones, which are played again."""
        if not self._on:
            return
        whole = self._directory / EPISODES
        # Whole files of later episodes go; the joined file may hold some as well.
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
        paths = (self._directory / PARTS).glob("*.safetensors")
        return sorted((path for path in paths if path.stem.isdecimal()), key=lambda p: int(p.stem))

    def _saved(self) -> Iterator[RecordedEpisode]:
        """Yield each written episode once, in order."""
        whole, last = self._directory / EPISODES, -1
        for path in [*([whole] if whole.is_file() else []), *self._parts()]:
            for episode in recording.read(path).episodes:
                if episode.number > last:  # the run may have been killed after joining it
                    last = episode.number
                    yield episode

    def _write(self, path: Path, episodes: list[RecordedEpisode]) -> None:
        driver = f"training on {self._config.terrain.title}"
        recording.write(path, driver, [(self._config, episodes)])

    def _remove(self, parts: list[Path]) -> None:
        for path in parts:
            path.unlink()
        folder = self._directory / PARTS
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
