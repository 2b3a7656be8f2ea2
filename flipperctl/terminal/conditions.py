"""The lines below a table that state the conditions of its episodes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

from flipperctl.evaluation.conditions import Conditions


def condition_lines(
    scenes: Iterable[tuple[str, int, Conditions]], varied: Collection[str] = ()
) -> Iterator[str]:
    """Yield a line for each set of conditions: name, seed, hashes, and the settings in words.

    ``scenes`` holds each scene's terrain, seed and conditions. ``varied``: see ``Conditions.line``.
    """
    groups: dict[tuple[str, int, str], list[str]] = {}
    for terrain, seed, conditions in scenes:
        key = (conditions.name, seed, conditions.line(varied))
        groups.setdefault(key, []).append(f"{terrain} {conditions.hash}")
    for (name, seed, words), hashes in groups.items():
        unique = ", ".join(dict.fromkeys(hashes))
        yield f"conditions {name}, seed {seed}, {unique}: {words}"
