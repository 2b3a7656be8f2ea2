"""The recorded episodes that a training learns from.

In: a file of recorded episodes. Out: transitions in the replay.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.agent.frames import stacked
from flipperctl.agent.replay import Replay
from flipperctl.api import MAX_HISTORY
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import Recording
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.training.recorded_fit import check_fit, notes


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
            f"agent.replay_size: {config.agent.replay_size:,} transitions leave no room besides "
            f"the {found.decisions:,} recorded ones of teacher.episodes={name}; raise it"
        )
    return found


def add_recorded(replay: Replay, config: TrainConfig, report: Callable[[str], None]) -> None:
    """Put the recorded episodes of the teacher, if there are any, into the replay of a new run.

    ``report`` receives notes on the conditions in which they differ from the training, and on the
    settings that have no effect on them.

    Raises:
        CheckpointError: their file is missing or damaged.
        ConfigError: they do not fit the training.
    """
    if (found := read_teacher(config)) is not None:
        for text in notes(config, found):
            report(text)
        fill(replay, found, config)


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
