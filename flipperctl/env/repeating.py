"""Equal seeds give equal episodes: copies of an episode, and a refusal of plugins that differ.

In: an environment, the generator and the actions of its episode. Out: the same instant of the same
episode, bit for bit; or an error that names the plugin with random numbers of its own. Engines hold
memory of other languages, which cannot be copied; equal actions lead to equal states.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flipperctl.api import Plugin
from flipperctl.core.targets import Action
from flipperctl.errors import FlipperctlError, PluginFailedError
from flipperctl.plugging.guard import definition, plugin_label, refusal
from flipperctl.plugging.randomness import moved_since

_OPTIONS = ("config", "actions", "render_mode", "renderer")
_KEPT = ("spec", "_first_seed")


@dataclass(frozen=True)
class Replayed:
    """What repeats an episode."""

    spawned: int
    """Children that the environment's generator had before the episode."""
    difficulty: float
    actions: list[Action] = field(default_factory=list)
    """The actions so far."""


def state_of(env: Any, replayed: Replayed | None) -> dict[str, Any]:
    """Return the state of an environment for ``restore``; ``replayed``: its episode, if any."""
    saved = {name: getattr(env, name) for name in (*_OPTIONS, *_KEPT)}
    rng = env.np_random
    saved["rng"] = _plain(rng, children(rng) if replayed is None else replayed.spawned)
    if replayed is not None:
        if env.drive.commands is not None:
            raise FlipperctlError(
                "an episode of an operator is repeated from its recording, not by a copy of it"
            )
        saved["episode"] = replayed.difficulty, list(replayed.actions), _instant(env)
    return saved


def restore(env: Any, saved: dict[str, Any], begin: Callable[[float, int | None], None]) -> None:
    """Make an environment that of ``state_of``; ``begin`` begins an episode of a difficulty."""
    type(env).__init__(env, **{name: saved[name] for name in _OPTIONS})
    for name in _KEPT:
        setattr(env, name, saved[name])
    # The generator as it was before the episode, whose children it spawns again.
    kind, seed, state = saved["rng"]
    bits = kind(np.random.SeedSequence(**seed))
    bits.state = state
    env.np_random = np.random.Generator(bits)
    # Engines cannot be copied: the actions are repeated, and must lead to the same instant.
    if "episode" in saved:
        difficulty, actions, instant = saved["episode"]
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


_DECISIONS = 3
"""Decisions with held flippers that are compared [-]."""


_CAUSES = {
    "ground": ("terrain",),
    "observation": ("sim", "perception"),
    "rewards": ("reward", "sim"),
}
"""First difference between two episodes → the kinds of plugins that can cause it."""


def require_unmoved(before: dict[str, object] | None, used: Sequence[Plugin], when: str) -> None:
    """Refuse the use of global generators since the states ``before``; None: do nothing.

    ``used``: the plugins that may have drawn; ``when``: what they did.
    """
    if before is not None and (moved := moved_since(before)):
        raise PluginFailedError(
            f"{_labels(used)}: uses {moved} {when}; only the generators that a plugin is given are "
            f"allowed, so that equal seeds give equal episodes ({definition(used[0])})"
        )


def require_repeatable(env: Any, seed: int) -> None:
    """Refuse plugins with which two episodes of one seed of ``env`` begin in different ways."""
    used = env.foreign
    if not used:
        return
    # The first difference between two beginnings tells which kinds of plugins can cause it.
    first, again = list(beginning(env, seed)), list(beginning(env, seed))
    for (what, value), (_, other) in zip(first, again, strict=False):
        if value != other:
            kinds = next(kinds for word, kinds in _CAUSES.items() if word in what)
            used = [plugin for plugin in used if plugin.kind in kinds] or used
            raise PluginFailedError(
                f"{_labels(used)}: two episodes of the seed {seed} differ in {what}; every random "
                "choice must come from the generators that a plugin is given "
                f"({definition(used[0])})"
            )
    # At difficulty 1 the terrain must be as it is configured.
    terrain = env.config.terrain
    if terrain not in used or (hardest := terrain.at(1.0)) is terrain:
        return
    grounds = [at.labelled(np.random.default_rng(seed)).points for at in (terrain, hardest)]
    if grounds[0].tobytes() != grounds[1].tobytes():
        text = f"returned other ground for difficulty 1 and seed {seed} than the terrain's"
        raise refusal(terrain, "at", f"{text}; it must be unchanged there")


def beginning(env: Any, seed: int) -> Iterator[tuple[str, object]]:
    """Yield what equal plugins repeat at the beginning of an episode, by what it is."""
    observation, _ = env.reset(seed=seed)
    hold = env.drive.action
    yield "their ground", env.profile.points.tobytes()
    yield "their first observation", observation.tobytes()
    for number in range(_DECISIONS):
        observation, _, *over, info = env.step(hold)
        yield f"their rewards of decision {number}", repr(info["rewards"])
        yield f"their observation after decision {number}", observation.tobytes()
        if any(over):
            break


def _labels(plugins: Sequence[Plugin]) -> str:
    return " or ".join(dict.fromkeys(map(plugin_label, plugins)))
