"""Parts of an evaluation's JSON document, from results that return plain data of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class Plain(Protocol):
    """A result that returns plain data."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""


def data(one: Plain | None) -> dict[str, Any] | None:
    """Return the result's data; None if there is none."""
    return None if one is None else one.to_dict()


def baselines(found: Sequence[Plain]) -> dict[str, Any]:
    """Return the entry ``baseline``, the first one, and ``baselines`` if there are several."""
    documents = [one.to_dict() for one in found]
    first = {"baseline": documents[0]} if documents else {}
    return first | ({"baselines": documents} if len(documents) > 1 else {})


def groups(by: Mapping[str, Sequence[Plain]]) -> dict[str, list[dict[str, Any]]]:
    """Return the groups of each number."""
    return {name: [group.to_dict() for group in found] for name, found in by.items()}


def parts(found: Mapping[str, Plain]) -> dict[str, Any]:
    """Return the entry ``parts``, or nothing if there are no parts."""
    return {"parts": {label: part.to_dict() for label, part in found.items()}} if found else {}
