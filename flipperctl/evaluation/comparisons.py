"""Correct the p-values of comparisons that are shown together (Holm 1979).

In: the differences of a policy from its baselines, on all scenes. Out: the same with ``p_holm``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from flipperctl.evaluation.intervals import holm
from flipperctl.evaluation.results import Differences


def correct_together(found: Sequence[Differences]) -> list[Differences]:
    """Return the differences with ``p_holm`` corrected across all of them and their parts."""
    corrected = iter(holm([p for one in found for p in _p_values(one)]))
    return [_with_next_p(one, corrected) for one in found]


def _p_values(one: Differences) -> Iterator[float]:
    yield one.success.p
    for part in one.parts.values():
        yield from _p_values(part)


def _with_next_p(one: Differences, corrected: Iterator[float]) -> Differences:
    """Return the differences with the next p-values, in the order of ``_p_values``."""
    success = replace(one.success, p_holm=next(corrected))
    parts: Mapping[str, Differences] = {
        k: _with_next_p(part, corrected) for k, part in one.parts.items()
    }
    return replace(one, success=success, parts=parts)
