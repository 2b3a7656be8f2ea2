"""Seeds of episodes, in three separate streams: training, validation and evaluation."""

from __future__ import annotations

from typing import Literal

import numpy as np

_STREAMS = {"training": 1, "validation": 2, "evaluation": 3}


def episode_seed(
    stream: Literal["training", "validation", "evaluation"], seed: int, episode: int
) -> int:
    """Return the seed of one episode; equal arguments give equal episodes on every machine."""
    sequence = np.random.SeedSequence(seed, spawn_key=(_STREAMS[stream], episode))
    return int(sequence.generate_state(1, np.uint32)[0])


def exploration_rng(seed: int, episode: int) -> np.random.Generator:
    """Return the generator with which a worker explores in one training episode."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4, episode)))
