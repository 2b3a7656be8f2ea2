"""Say where the trainings of one method differ in more than their seeds.

In: the settings of each training. Out: a sentence that names the settings in which they differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

_NAMED = 3  # settings in the sentence
_START = "agent.start_from"


def tell_unlike(trainings: Sequence[Mapping[str, Any]]) -> str:
    """Return a sentence on the settings that differ; an empty one if none does."""
    unlike = [f"{key} ({', '.join(values)})" for key, values in _unlike(trainings)]
    if not unlike:
        return ""
    more = f" and {len(unlike) - _NAMED} more" if len(unlike) > _NAMED else ""
    return (
        f"its policies were trained with different settings: {', '.join(unlike[:_NAMED])}{more}; "
        "trainings of one method differ in their seeds alone, and METHOD=DIR gives others a name "
        "of their own"
    )


def _unlike(trainings: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[str]]]:
    """Yield each key in which trainings differ, and its values."""
    settings = [dict(_flat(training)) for training in trainings]
    for key in dict.fromkeys(key for one in settings for key in one):
        values = [one.get(key) for one in settings]
        if key == _START:  # each training seed may go on from a run of its own
            values = ["a run" if value else value for value in values]
        if len(shown := dict.fromkeys(map(str, values))) > 1:
            yield key, list(shown)


def _flat(settings: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the settings by their keys, such as ``agent.gamma``."""
    for name, value in settings.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", value
