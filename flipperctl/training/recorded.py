"""Recorded episodes in a training: those that it learns from, and those that it writes.

In: a file of recorded episodes; the steps of the training. Out: transitions in the replay; a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.agent.replay import Replay
from flipperctl.api import MAX_HISTORY
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import RecordedEpisode, Recording
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.rollout.recording import EpisodeRecorder
from flipperctl.rollout.values import Step
from flipperctl.training.recorded_fit import check_fit

EPISODES = Path("episodes.safetensors")
"""File of a run directory with the episodes of the training, if ``train.record`` asks for it."""


def read_teacher(config: TrainConfig) -> Recording | None:
    """Return the recorded episodes that a training learns from, or None without any.

    Raises:
        CheckpointError: the file is missing, damaged or of another kind.
        ConfigError: the episodes do not fit the training.
    """
    name = config.teacher.episodes
    if name is None:
        return None
    found = recording.read(Path(name))
    check_fit(config, found)
    if found.decisions >= config.agent.replay_size:
        raise ConfigError(
            f"agent.replay_size: {config.agent.replay_size:,} transitions leave no room beside the "
            f"{found.decisions:,} recorded ones of teacher.episodes={name}; make it larger"
        )
    return found


def fill(replay: Replay, found: Recording, config: TrainConfig) -> None:
    """Put all recorded decisions into an empty replay, which never overwrites them."""
    frames, bootstrapped = config.network.frames, config.agent.bootstrap_outcomes
    for episode in found.episodes:
        rows = [_row(episode.observations, t, frames) for t in range(len(episode.observations))]
        last = len(episode.actions) - 1
        for t, action in enumerate(episode.actions):
            replay.add(
                rows[t],
                int(action),
                float(episode.rewards[t]),
                rows[t + 1],
                over=t == last,
                bootstrap=t == last and episode.outcome in bootstrapped,
                label=episode.labels[t],
            )
    replay.keep()


def _row(observations: NDArray[np.float32], t: int, frames: int) -> NDArray[np.float32]:
    """Return the network's input at decision ``t`` of an episode."""
    return stacked(list(observations[max(0, t + 1 - MAX_HISTORY) : t + 1]), frames)


class TrainingRecorder:
    """Keeps the episodes of a training and writes them beside its checkpoints."""

    def __init__(self, config: TrainConfig, directory: Path) -> None:
        """Keep nothing unless ``train.record`` asks for it."""
        self._config, self._path = config, directory / EPISODES
        self._on, self._size = config.train.record, config.perception.size
        self._running, self._episodes = EpisodeRecorder(), list[RecordedEpisode]()

    def add(self, step: Step, number: int) -> None:
        """Add a step of the episode with this number, counted from 0."""
        if not self._on:
            return
        newest = slice(-self._size, None)  # of the frames that the network takes
        self._running.add(
            step.observation[newest],
            step.action,
            step.reward,
            step.next_observation[newest],
            step.label,
        )
        if step.ending is not None:
            self._episodes.append(self._running.finish(number, step.ending))

    def drop(self) -> None:
        """Discard the running episode."""
        self._running.drop()

    def save(self) -> None:
        """Write the episodes that ended, completely or not at all.

        Raises:
            OutputError: the file cannot be written.
            WriteError: writing failed half way; the old file is kept.
        """
        if self._on:
            driver = f"training on {self._config.terrain.plugin_name}"
            recording.write(self._path, driver, [(self._config, self._episodes)])

    def restore(self, episodes: int) -> None:
        """Go on after that many episodes of the run; later ones are played again.

        Raises:
            CheckpointError: the file is damaged.
        """
        if self._on and self._path.is_file():
            self._episodes = _first(recording.read(self._path).episodes, episodes)


def _first(found: Sequence[RecordedEpisode], count: int) -> list[RecordedEpisode]:
    return [episode for episode in found if episode.number < count]
