"""Refuses plugins whose episodes do not repeat: equal seeds must give equal ground and rewards.

In: an environment. Out: nothing, or an error that names what draws random numbers of its own. Only
plugins that are not part of flipperctl are looked at, since it takes time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

from flipperctl.api import Plugin, Profile, action_index
from flipperctl.errors import PluginFailedError
from flipperctl.guard import definition, plugin_label
from flipperctl.randomness import moved_since

_DECISIONS = 3
"""Decisions with held flippers that are compared [-]."""


class Episodes(Protocol):
    """The part of the environment that is tried."""

    profile: Profile

    @property
    def foreign(self) -> Sequence[Plugin]:
        """Plugins of the episodes that are not part of flipperctl."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Simulate a decision."""


def require_unmoved(before: dict[str, object] | None, used: Sequence[Plugin], when: str) -> None:
    """Refuse the use of global generators since the states ``before``; None: do nothing.

    ``used``: the plugins of which one may have drawn; ``when``: what they did.

    Raises:
        PluginFailedError: Python's, numpy's or torch's global generator was used.
    """
    if before is not None and (moved := moved_since(before)):
        raise PluginFailedError(
            f"{_labels(used)}: uses {moved} {when}; only the generators that a plugin is given are "
            f"allowed, so that equal seeds give equal episodes ({definition(used[0])})"
        )


def require_repeatable(env: Episodes, seed: int) -> None:
    """Refuse plugins with which two episodes of one seed begin in different ways.

    Raises:
        PluginFailedError: they do.
    """
    used = env.foreign
    if not used:
        return
    first, again = list(_beginning(env, seed)), list(_beginning(env, seed))
    for (what, one), (_, other) in zip(first, again, strict=False):
        if one != other:
            raise PluginFailedError(
                f"{_labels(used)}: two episodes of the seed {seed} differ in {what}; every random "
                "choice must come from the generators that a plugin is given "
                f"({definition(used[0])})"
            )


def _beginning(env: Episodes, seed: int) -> Iterator[tuple[str, object]]:
    observation, _ = env.reset(seed=seed)
    yield "their ground", env.profile.points.tobytes()
    yield "their first observation", observation.tobytes()
    for number in range(_DECISIONS):
        observation, _, *over, info = env.step(action_index(0, 0))
        yield f"their rewards of decision {number}", repr(info["rewards"])
        yield f"their observation after decision {number}", observation.tobytes()
        if any(over):
            break


def _labels(plugins: Sequence[Plugin]) -> str:
    return " or ".join(dict.fromkeys(map(plugin_label, plugins)))
