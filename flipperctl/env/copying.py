"""Copies and pickles of an environment: its episode is begun again and repeated, bit for bit.

In: the generator and the actions of an episode. Out: the same instant of the same episode. Engines
hold memory of other languages, which cannot be copied; what equal actions lead to is equal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flipperctl.errors import FlipperctlError

_OPTIONS = ("config", "render_mode", "renderer")
_OF_GYMNASIUM = ("spec", "_np_random_seed")


@dataclass(frozen=True)
class Replayed:
    """What repeats an episode."""

    spawned: int
    """Children that the environment's generator had before the episode."""
    difficulty: float
    actions: list[int] = field(default_factory=list)
    """Indices of the actions so far."""


def state_of(env: Any, replayed: Replayed | None) -> dict[str, Any]:
    """Return what ``restore`` needs of an environment; ``replayed``: its episode, if it has one."""
    kept = {name: getattr(env, name) for name in (*_OPTIONS, *_OF_GYMNASIUM)}
    if (rng := env._np_random) is not None:
        kept["rng"] = _plain(rng, children(rng) if replayed is None else replayed.spawned)
    if replayed is not None:
        kept["episode"] = replayed.difficulty, list(replayed.actions), _instant(env)
    return kept


def restore(env: Any, kept: dict[str, Any], begin: Callable[[float, int | None], None]) -> None:
    """Make an environment that of ``state_of``; ``begin`` begins an episode of a difficulty.

    Raises:
        FlipperctlError: the episode does not repeat.
    """
    type(env).__init__(env, **{name: kept[name] for name in _OPTIONS})
    for name in _OF_GYMNASIUM:
        setattr(env, name, kept[name])
    if "rng" in kept:
        kind, seed, state = kept["rng"]
        bits = kind(np.random.SeedSequence(**seed))
        bits.state = state
        env._np_random = np.random.Generator(bits)
    if "episode" in kept:
        difficulty, actions, instant = kept["episode"]
        begin(difficulty, None)
        for action in actions:
            env.step(action)
        if _instant(env) != instant:
            raise FlipperctlError(
                "the copy of a running environment repeats its episode, which came to another "
                "state; env.unwrapped.simulator() is a copy of the scene with snapshots (save, "
                "load)"
            )


def children(rng: np.random.Generator) -> int:
    """Return the number of children that a generator has spawned."""
    return int(getattr(rng.bit_generator.seed_seq, "n_children_spawned", 0))


def _plain(rng: np.random.Generator, spawned: int) -> tuple[Any, dict[str, Any], Any]:
    """Return a generator as plain data, as it was when it had ``spawned`` children."""
    bits = rng.bit_generator
    seed = bits.seed_seq
    assert isinstance(seed, np.random.SeedSequence)  # as of every generator that can spawn
    return type(bits), {**seed.state, "n_children_spawned": spawned}, bits.state


def _instant(env: Any) -> tuple[float, ...]:
    """Return what two equal episodes have in common at this instant."""
    state = env.state
    return (*state.position.tolist(), state.pitch, state.front, state.rear, state.time)
