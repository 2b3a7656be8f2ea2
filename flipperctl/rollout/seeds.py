"""Seeds of episodes: three streams that never meet."""

from __future__ import annotations

from typing import Literal

import numpy as np

_STREAMS = {"training": 1, "validation": 2, "evaluation": 3}


def episode_seed(
    stream: Literal["training", "validation", "evaluation"], seed: int, episode: int
) -> int:
    """The seed of one episode; equal arguments give equal episodes on every machine."""
    sequence = np.random.SeedSequence(seed, spawn_key=(_STREAMS[stream], episode))
    return int(sequence.generate_state(1, np.uint32)[0])


def exploration(seed: int, episode: int) -> np.random.Generator:
    """What a worker explores one training episode with."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4, episode)))
