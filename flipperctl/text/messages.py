"""Texts of errors: close matches, and pydantic's validation errors as one line each."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from flipperctl.text.elsewhere import called_here

if TYPE_CHECKING:  # pydantic costs 40 ms, and the command line's help needs only close matches
    from pydantic import BaseModel, ValidationError

_LONGEST = 600  # characters of a validator's message
_ALIKE = 0.7
"""Smallest similarity of a misspelling: planner and none have 0.55, stair and stiar 0.8."""
_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
_FAULTS = {
    "less_than": "is not allowed",
    "greater_than": "is not allowed",
    "literal_error": "is not allowed",
    "float_": "is no number",
    "finite_number": "is no finite number",
    "int_": "is no whole number",
    "bool_": "is neither true nor false",
}
"""Beginning of a validator's type of error → what is wrong with the value."""


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, as in ``1 run`` and ``2 runs``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def percent(rate: float) -> str:
    """Return a rate from 0 to 1 in percent, as in ``37.5 %``."""
    return f"{100 * rate:.3g} %"


def spans(numbers: Sequence[int]) -> str:
    """Return ascending numbers, with three or more in a row as in ``0 to 2, 5``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    parts = ([f"{run[0]} to {run[-1]}"] if len(run) > 2 else map(str, run) for run in runs)
    return ", ".join(text for part in parts for text in part)


def closest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that ``word`` is probably a misspelling or abbreviation of."""
    words = list(known)
    if matches := difflib.get_close_matches(word.lower(), words, n=1, cutoff=_ALIKE):
        return matches[0]
    begins = [w for w in words if _begins(w, word.lower())]  # eval, evaluate
    return begins[0] if len(begins) == 1 else None


def close_match(word: str, known: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the closest known word; empty without one."""
    return suggestion(*filter(None, [closest(word, known)]))


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """Return the error for a name that is not known, with its close match and all known ones.

    ``what``: where it stands, and the noun, as in ``--metric: there is no column``.
    """
    names = list(known)
    return f"{what} {name!r}{close_match(name, names)}; known: {', '.join(names) or 'none'}"


def suggestion(*meant: str, quoted: bool = True) -> str:
    """Return `` (did you mean 'x' or 'y'?)``, which follows what was typed; empty for none."""
    alternatives = " or ".join(repr(word) if quoted else word for word in meant)
    return f" (did you mean {alternatives}?)" if alternatives else ""


def _begins(first: str, second: str) -> bool:
    """Return whether the shorter of two words, of at least three letters, begins the longer."""
    short, long = sorted((first, second), key=len)
    return len(short) >= 3 and long.startswith(short)


def broken_hint(name: str = "") -> str:
    """Return a hint at the installed packages that do not load: those with a name, or all."""
    from flipperctl.api.plugin import broken

    reasons = [package.reason for package in broken if not name or name in package.names]
    return f"; it may be in a package that does not load: {'; '.join(reasons)}" if reasons else ""


def missing_name(name: str, known: Iterable[str]) -> str:
    """Return a hint about a plugin that is not found: its close match, or how one is loaded."""
    hint = broken_hint(name) or file_here(name) or _of_another_kind(name)
    hint = hint or called_here(name) or close_match(name, known) or broken_hint()
    return hint or "; a plugin of your own is loaded by --plugins FILE"


def _of_another_kind(name: str) -> str:
    """Return a hint at the settings that take a plugin of this name; empty without one."""
    from flipperctl.api import registry

    kinds = "terrain", "network", "agent", "sim", "perception", "logger"
    keys = {kind: kind for kind in kinds} | {"reward": f"rewards.{name}"}
    meant = [f"{key}={name}" for kind, key in keys.items() if (kind, name) in registry]
    return suggestion(*meant, quoted=False)


def file_here(name: str) -> str:
    """Return a hint at a file of Python in the current folder; empty without one."""
    file = f"{name}.py"
    here = any(path.name == file for path in Path().glob("*.py"))
    return f" ({file} is here: add --plugins {file})" if here else ""


def missing_plugin(kind: str, name: str, file: str | Path | None) -> str:
    """Return the error text for a missing plugin.

    ``file``: the name of the file that it came from, or the path of a copy that the run has.
    """
    advice = "install it or name its file with --plugins"
    if file is not None:
        origin = "this run brings" if isinstance(file, Path) else "it came from"
        advice = f"{origin} {Path(file).name}: add --plugins {shlex.quote(str(file))}"
    return f"there is no {kind} plugin {name!r}; {advice}{broken_hint(name) or broken_hint()}"


def bounds(model: type[BaseModel], field: str) -> str:
    """Return the bounds of a field, as in ``> 0, ≤ 0.4``; empty without bounds."""
    info = model.model_fields.get(field)
    parts = []
    for item in info.metadata if info else ():
        for name, sign in _BOUNDS.items():
            value = getattr(item, name, None)
            if value is not None:
                parts.append(f"{sign} {value:g}")
    return ", ".join(parts)


def _allowed(model: type[BaseModel], field: str) -> str:
    """Return the bounds of a field with its unit, as in ``> 0, ≤ 0.4 m``."""
    measured = unit(model, field)
    return f"{bounds(model, field)} {'' if measured == '-' else measured}".rstrip()


def _allowed_by(context: Mapping[str, Any]) -> str:
    """Return what a validator allows, as it says it: bounds or values; empty for neither."""
    parts = [f"{sign} {context[name]:g}" for name, sign in _BOUNDS.items() if name in context]
    parts += [context["expected"]] if "expected" in context else []
    return f" ({', '.join(parts)})" if parts else ""


def unit(model: type[BaseModel], field: str) -> str:
    """Return the unit at the end of a field's description, as in ``m``; empty without one."""
    return _split(model, field)[1]


def meaning(model: type[BaseModel], field: str) -> str:
    """Return a field's description without its unit."""
    return _split(model, field)[0]


def _split(model: type[BaseModel], field: str) -> tuple[str, str]:
    if field not in model.model_fields:  # a factor, of ``Settings.factors``
        return "", ""
    text = model.model_fields[field].description or ""
    match = re.fullmatch(r"(.*) \[([^\]]*)\]", text, flags=re.DOTALL)
    return (match[1], match[2]) if match else (text, "")


def explain(
    error: ValidationError,
    where: str,
    model: type[BaseModel],
    validated: Mapping[str, Any] | None = None,
) -> str:
    """Return the first error of a validation as one line: path, value, what is allowed.

    ``validated`` is the validated document, which names the plugins within the model's fields.
    """
    first = error.errors()[0]
    location = ".".join(map(str, (*([where] if where else []), *first["loc"])))
    owner, known = _owner(model, first["loc"], validated or {})

    # The errors that have a text of their own: an unknown key and an unknown plugin
    leaf = str(first["loc"][-1]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        hint = called_here(leaf) or file_here(leaf) or close_match(leaf, known)
        return f"{location}: there is no such key{hint}; known: {', '.join(known)}"
    if first["type"] == "unknown_plugin":
        name, known = first["ctx"]["name"], first["ctx"]["known"]
        return (
            f"{location}: {first['msg']}{missing_name(str(name), known)}; "
            f"registered: {', '.join(known)}"
        )

    # A value out of bounds, or of a wrong type
    allowed = f" ({_allowed(owner, leaf)})" if owner and bounds(owner, leaf) else ""
    more = len(error.errors()) - 1
    rest = f" (and {more} more)" if more else ""
    for kind, fault in _FAULTS.items():
        if first["type"].startswith(kind):
            allowed = allowed or _allowed_by(first.get("ctx", {}))
            return f"{location}: {_short(first['input'])} {fault}{allowed}{rest}"

    # For all others the validator's message, with the bounds and the value that it leaves out
    message = " ".join(first["msg"].removeprefix("Value error, ")[:_LONGEST].split())
    of_model = first["type"] == "value_error" and isinstance(first["input"], Mapping)
    value = "" if of_model else f"; the value is {_short(first['input'])}"
    return f"{location}: {message}{allowed}{value}{rest}"


def explain_unknown_key(key: str, node: Mapping[str, Any]) -> str:
    """Return the error for a dotted key that the nested mapping ``node`` does not have."""
    # The first part of the key that does not exist is the one to explain.
    *parents, leaf = key.split(".")
    inside = ""  # the innermost existing section on the path to the key
    for parent in parents:
        if not isinstance(node.get(parent), dict):
            leaf = parent
            break
        node, inside = node[parent], f"{inside}.{parent}".lstrip(".")

    # What there is in its place, and where else a key of this name is
    known = sorted(name for name in node if name != "name")
    place = f"{inside}={node['name']}" if "name" in node else inside
    inner = [path for path in _paths(node) if not inside and path.endswith(f".{leaf}")]
    hint = suggestion(*inner, quoted=False) if len(inner) <= 3 else ""
    other = _of_siblings(inside, leaf) or called_here(leaf) or file_here(leaf)
    if inside and not known:
        return f"{key}: there is no such key; {place} has no settings here"
    return (
        f"{key}: there is no such key{hint or other or close_match(leaf, known)}; "
        f"known {'in ' + place if place else 'groups and keys'}: {', '.join(known)}"
    )


def _of_siblings(kind: str, field: str) -> str:
    """Return a hint at the plugins of a kind that have a setting; empty without, or for many."""
    from flipperctl.api import registry

    words = [f"{k}={name}" for (k, name), c in registry.items() if k == kind and _has(c, field)]
    return f" ({' or '.join(words)} has it)" if 0 < len(words) <= 3 else ""


def _has(cls: type[BaseModel], field: str) -> bool:
    return field in cls.model_fields


def _paths(node: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """Yield the path of every key in nested mappings."""
    for name, value in node.items():
        yield f"{before}{name}"
        if isinstance(value, dict):
            yield from _paths(value, f"{before}{name}.")


def _owner(
    model: type[BaseModel], location: tuple[int | str, ...], validated: Any
) -> tuple[type[BaseModel] | None, list[str]]:
    """Return the model whose field the last part of the location names, and its fields."""
    from pydantic import BaseModel

    from flipperctl.api import Plugin, registry

    owner: type[BaseModel] | None = model
    for part in location[:-1]:
        if not isinstance(part, int):  # an integer is an item of the field before it
            info = owner.model_fields.get(part) if owner else None
            owner = _model_in(info.annotation, BaseModel) if info else None
        try:
            validated = validated[part]
        except (KeyError, IndexError, TypeError):
            validated = None
        if not (owner and issubclass(owner, Plugin) and isinstance(validated, Mapping)):
            continue
        if "name" in validated:
            owner = registry.get((owner.kind, str(validated["name"])), owner)
    return owner, sorted(owner.model_fields) if owner else []


def _model_in(annotation: Any, base: type[BaseModel]) -> type[BaseModel] | None:
    """Return the first model in an annotation such as ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, base):
        return annotation
    inner = (_model_in(item, base) for item in get_args(annotation))
    return next((owner for owner in inner if owner is not None), None)


def _short(value: object) -> str:
    try:
        text = dict(value).__repr__() if isinstance(value, Mapping) else repr(value)
    except ValueError:  # an integer with more digits than Python converts
        text = f"a {type(value).__name__} of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."
