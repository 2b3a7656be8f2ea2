"""Say where the trainings of one method differ in more than their seeds.

In: the settings of each training. Out: a sentence that names the settings in which they differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from flipperctl.policies.identity import without_sources

_NAMED = 3
"""Settings in the sentence, and values of each."""
_LENGTH = 40
"""Longest value in the sentence, in characters."""


def tell_unlike(trainings: Sequence[Mapping[str, Any]]) -> str:
    """Return a sentence on the settings that differ; an empty one if none does."""
    found = list(_unlike([without_sources(training) for training in trainings]))
    if not found:
        return ""
    named = ", ".join(f"{key} ({_shown(values)})" for key, values in found[:_NAMED])
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return (
        f"its policies were trained with different settings: {named}{more}; trainings of one "
        "method differ in their seeds alone, and METHOD=DIR gives others a name of their own"
    )


def _unlike(values: Sequence[Any], path: str = "") -> Iterator[tuple[str, Sequence[Any]]]:
    """Yield each key in which values differ, such as ``agent.gamma``, and its values."""
    if all(isinstance(value, Mapping) for value in values):
        for key in dict.fromkeys(key for value in values for key in value):
            inner = [value.get(key) for value in values]
            absent = [value for value in values if key not in value]
            # A setting that some lack is newer than their training; a plugin was left out.
            if not absent or any(isinstance(one, Mapping) for one in inner):
                yield from _unlike(inner, f"{path}.{key}" if path else key)
    elif all(isinstance(value, list) and len(value) == len(values[0]) for value in values):
        for index in range(len(values[0])):
            yield from _unlike([value[index] for value in values], f"{path}[{index}]")
    elif any(value != values[0] for value in values):
        yield path, values


def _shown(values: Sequence[Any]) -> str:
    """Return different values as text, not longer than a line."""
    texts = list(dict.fromkeys(map(str, values)))
    short = [text if len(text) <= _LENGTH else f"{text[:_LENGTH]}…" for text in texts]
    more = [f"{len(short) - _NAMED} more"] if len(short) > _NAMED else []
    return ", ".join([*short[:_NAMED], *more])
