"""Words for errors: close matches, and pydantic's findings as one line each."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # pydantic costs 40 ms, and the command line's help needs only close matches
    from pydantic import BaseModel, ValidationError

_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}


def close_match(word: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?``, or nothing."""
    found = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f"; did you mean {found[0]!r}?" if found else ""


def bounds(model: type[BaseModel], field: str) -> str:
    """The bounds of a field, as in ``> 0, ≤ 0.4``; empty without bounds."""
    info = model.model_fields.get(field)
    parts = []
    for item in info.metadata if info else ():
        for name, sign in _BOUNDS.items():
            value = getattr(item, name, None)
            if value is not None:
                parts.append(f"{sign} {value:g}")
    return ", ".join(parts)


def explain(error: ValidationError, where: str, model: type[BaseModel]) -> str:
    """The first finding of a validation in one line: path, value, what is allowed."""
    first = error.errors()[0]
    location = (
        ".".join([where, *map(str, first["loc"])]) if where else ".".join(map(str, first["loc"]))
    )
    owner, known = _owner(model, first["loc"])
    leaf = str(first["loc"][-1]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        hint = close_match(leaf, known)
        return f"{location}: there is no such key{hint}; known: {', '.join(known)}"
    allowed = f" ({bounds(owner, leaf)})" if owner and bounds(owner, leaf) else ""
    more = len(error.errors()) - 1
    rest = f" (and {more} more)" if more else ""
    message = first["msg"].removeprefix("Value error, ")
    return f"{location}: {message}{allowed}; the value is {_short(first['input'])}{rest}"


def _owner(
    model: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[type[BaseModel] | None, list[str]]:
    from pydantic import BaseModel

    owner: Any = model
    for part in location[:-1]:
        info = owner.model_fields.get(str(part)) if owner else None
        owner = info.annotation if info else None
        if not (isinstance(owner, type) and issubclass(owner, BaseModel)):
            return None, []
    return owner, sorted(owner.model_fields)


def _short(value: object) -> str:
    text = dict(value).__repr__() if isinstance(value, Mapping) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
