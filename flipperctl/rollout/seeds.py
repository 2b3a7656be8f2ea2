"""Seeds of episodes in three streams with disjoint ranges, and the generator for exploration.

Training seeds are 32-bit numbers. Validation and evaluation seeds are the stream's number followed
by 50 random bits; all are below 2^53, so that every JSON reader keeps all their digits.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

import numpy as np

from flipperctl.api import Terrain
from flipperctl.config import identity

_TRAINING, _VALIDATION, _EVALUATION, _EXPLORATION = 1, 2, 3, 4
_RANDOM_BITS = 50


def training_seed(seed: int, episode: int) -> int:
    """Return the seed of a training episode, below 2^32; ``seed`` is that of the training."""
    return int(_sequence(seed, _TRAINING, episode).generate_state(1, np.uint32)[0])


def validation_seed(seed: int, episode: int) -> int:
    """Return the seed of a validation episode, from 2^51 on; ``seed`` is that of validations."""
    return _long_seed(_VALIDATION, seed, episode)


@dataclass(frozen=True)
class EvaluationSeeds:
    """The seeds of an evaluation's episodes on one terrain, from 3 · 2^50 on.

    Equal arguments give equal seeds on every machine. The seeds of two terrains differ, so that
    episodes on several terrains are independent samples. Physics, sensing, start, engine and policy
    do not influence the seeds, so that all of them meet the same ground.
    """

    seed: int
    """Seed of the evaluation."""
    terrain: tuple[int, ...]
    """Four 32-bit words of the SHA-256 of the terrain's ``config.identity``."""

    @classmethod
    def of(cls, seed: int, terrain: Terrain) -> EvaluationSeeds:
        """Return the seeds of an evaluation on a terrain."""
        text = json.dumps(identity(terrain), sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(text.encode()).digest()
        return cls(seed, tuple(np.frombuffer(digest[:16], "<u4").tolist()))

    def __call__(self, episode: int) -> int:
        """Return the seed of an episode, counted from 0."""
        return _long_seed(_EVALUATION, self.seed, *self.terrain, episode)

    def first(self, count: int) -> list[int]:
        """Return the seeds of the first episodes."""
        return [self(episode) for episode in range(count)]


def exploration_rng(seed: int, episode: int) -> np.random.Generator:
    """Return the generator of a worker's exploration in one training episode."""
    return np.random.default_rng(_sequence(seed, _EXPLORATION, episode))


def _long_seed(stream: int, seed: int, *key: int) -> int:
    (word,) = _sequence(seed, stream, *key).generate_state(1, np.uint64)
    return (stream << _RANDOM_BITS) | (int(word) >> (64 - _RANDOM_BITS))


def _sequence(seed: int, stream: int, *key: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(stream, *key))
