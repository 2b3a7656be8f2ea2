"""The checks of a plugin: callables whose error states the fault, its place and the value.

In: a plugin's class. Out: its checks. Each runs on the plugin at its defaults, most of them also at
the outermost values of each field. The checks of every kind of plugin are here: its registration,
documentation and serialisation. A check of one kind is marked ``@of(kind, name)`` in the module of
``_MODULES``.
"""

from __future__ import annotations

import inspect
import json
import math
import re
import time
import types
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, ClassVar, Literal, NamedTuple, TypeVar, Union, get_args, get_origin
from unittest import SkipTest

import numpy as np
from pydantic import ValidationError

from flipperctl.api import IntRange, Plugin, Range, registry
from flipperctl.config import resolver
from flipperctl.errors import ConfigError, ConformanceError, FlipperctlError
from flipperctl.plugging import plugins as loader
from flipperctl.plugging.guard import definition, error_line, place, plugin_label

_MODULES = {
    "terrain": "terrain",
    "sim": "engine",
    "perception": "sensor",
    "reward": "recorded",
    "measure": "recorded",
    "logger": "recorded",
    "network": "policies",
    "controller": "policies",
    "command": "command",
    "agent": "learner",
}
"""Kind of plugin → module with its checks."""
_BOUNDS = {"ge": 0, "le": 0, "gt": 1, "lt": -1}
"""Kind of bound → direction from the bound to the nearest allowed value [-]."""

TestT = TypeVar("TestT", bound=Callable[[Any], None])
_tests: dict[str, list[tuple[str, Callable[[Any], None], bool]]] = defaultdict(list)
"""Kind of plugin → names and functions of its checks, and whether each runs at every variant."""


class NotChecked(SkipTest):  # pytest and unittest show it as a skipped test
    """The check needs a package that is not installed; the text names the extra."""


@dataclass(frozen=True)
class Check:
    """A named check of a plugin; calling it returns if the plugin passes."""

    plugin: type[Plugin]
    name: str
    run: Callable[[], None]
    """Performs the check; its errors do not name the plugin."""

    def __call__(self) -> None:
        """Run the check.

        Raises:
            ConformanceError: the plugin fails; the text gives plugin, value and what is allowed.
            NotChecked: a package that the check needs is not installed.
        """
        if error := _failure(self.run, self.plugin):
            raise ConformanceError(f"{plugin_label(self.plugin)} {error}") from error.__cause__

    def __str__(self) -> str:
        """Return kind, plugin and check, as the id of a test."""
        name = getattr(self.plugin, "plugin_name", self.plugin.__name__)
        return f"{self.plugin.kind}-{name}-{self.name}"


class Conformance:
    """Base class of a test class that names the ``plugin`` to check."""

    plugin: ClassVar[type[Plugin]]
    settings: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    """Settings that the plugin needs, such as a file."""
    pictures: ClassVar[Path | None] = None
    """Folder for pictures of the terrain at its defaults and at each bound, if any."""

    def pytest_generate_tests(self, metafunc: Any) -> None:
        """Make one test of each check."""
        if "check" in metafunc.fixturenames:
            tests = checks(self.plugin, pictures=self.pictures, settings=self.settings)
            metafunc.parametrize("check", tests, ids=str)

    def test_keeps_the_contract(self, check: Check) -> None:
        """Fail with the plugin, the value and the allowed values."""
        check()


def of(kind: str, name: str, *, everywhere: bool = True) -> Callable[[TestT], TestT]:
    """Register a function as a check of one kind of plugin.

    It runs at the plugin's defaults or, if ``everywhere``, at every variant.
    """

    def decorate(test: TestT) -> TestT:
        _tests[kind].append((name, test, everywhere))
        return test

    return decorate


def checks(
    *plugins: type[Plugin],
    pictures: Path | None = None,
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> list[Check]:
    """Return all checks of the plugins.

    ``pictures``: folder for pictures of the terrains; ``settings``: what each plugin needs.
    """
    loader.load()  # a plugin may contain others
    return [check for cls in plugins for check in _checks(cls, pictures, settings)]


def package_checks(package: ModuleType) -> list[Check]:
    """Return all checks of all plugins that an imported package has registered."""
    begin = package.__name__.partition(".")[0]
    classes = [c for _, c in sorted(registry.items()) if c.__module__.partition(".")[0] == begin]
    if not classes:
        raise ConformanceError(f"the package {begin} registers no plugin")
    return checks(*classes)


def _checks(
    cls: type[Plugin], pictures: Path | None, settings: Mapping[str, Any]
) -> Iterator[Check]:
    all_variants = cache(lambda: variants(cls, settings))

    def at(name: str, test: Callable[[Any], None], *, everywhere: bool) -> Check:
        last = None if everywhere else 1
        return Check(cls, name, lambda: _run_on_variants(all_variants()[:last], test))

    yield Check(cls, "registered", lambda: _registered(cls))
    yield Check(cls, "documented", lambda: _documented(cls))
    yield at("checkpoint", _checkpoint, everywhere=True)
    if getattr(cls, "remote", False):
        return
    module = import_module(f"flipperctl.testing.{_MODULES[cls.kind]}")
    # A search at its largest settings may take hours.
    searches = getattr(cls, "searches_first", False)
    for name, test, everywhere in _tests[cls.kind]:
        yield at(name, test, everywhere=everywhere and not searches)
    if cls.kind not in ("logger", "agent", "command"):  # which give an environment nothing
        elsewhere = import_module("flipperctl.testing.elsewhere")
        yield at("another process", elsewhere.another_process, everywhere=False)
    if cls.kind == "terrain" and pictures is not None:
        yield Check(cls, "pictures", lambda: module.write_pictures(all_variants(), pictures))


def run_checks(todo: Sequence[Check], report: Callable[[str, float], None]) -> list[dict[str, Any]]:
    """Run every check; return whether each passed or was skipped, its message and its time [s].

    ``report`` is called with the name of the next one and the finished fraction.
    """
    rows = []
    for index, check in enumerate(todo):
        report(str(check), index / len(todo))
        # A check may pass, fail or be skipped, and the next one runs in any case.
        begun, text, ok, skipped = time.perf_counter(), "", True, False
        try:
            check()
        except ConformanceError as error:
            text, ok = str(error), False
        except NotChecked as error:
            text, skipped = str(error), True
        rows.append(
            {
                "kind": check.plugin.kind,
                "name": getattr(check.plugin, "plugin_name", check.plugin.__name__),
                "check": check.name,
                "ok": ok,
                "skipped": skipped,
                "message": text,
                "seconds": time.perf_counter() - begun,
            }
        )
    return rows


def require_passed(rows: Sequence[dict[str, Any]]) -> None:
    """Raise ``ConformanceError`` if a check failed; the text names plugins and checks."""
    if failed := [f"{row['kind']} {row['name']} ({row['check']})" for row in rows if not row["ok"]]:
        raise ConformanceError(
            f"{len(failed)} of {len(rows)} checks failed: {', '.join(failed[:10])}"
            + (" …" if len(failed) > 10 else "")
        )


def require(holds: bool, text: str) -> None:
    """Raise ``ConformanceError`` with this text unless the condition holds."""
    if not holds:
        raise ConformanceError(text)


def _failure(run: Callable[[], None], plugin: Plugin | type[Plugin]) -> ConformanceError | None:
    """Return what a check raised, in one line with file and line unless the core raised it."""
    try:
        run()
    except ConformanceError as error:
        return error
    except (SkipTest, KeyboardInterrupt):
        raise
    except BaseException as error:  # noqa: BLE001  # the plugin's own code may raise anything
        of_core = isinstance(error, FlipperctlError)
        where = "" if of_core else f" ({place(error) or definition(plugin)})"
        failure = ConformanceError(f"raises {error_line(error)}{where}")
        failure.__cause__ = error
        return failure
    return None


def _run_on_variants(variants: Sequence[Variant], test: Callable[[Any], None]) -> None:
    """Run a test on every variant; the error describes the first failure and names the others."""
    with np.errstate(all="ignore"):  # at the smallest float, a quotient may overflow
        results = ((v.label, _failure(partial(test, v.plugin), v.plugin)) for v in variants)
        failed = [(label, error) for label, error in results if error]
    if failed:
        label, first = failed[0]
        others = ", ".join(label for label, _ in failed[1:])
        more = f" (it also fails with {others})" if others else ""
        raise ConformanceError(f"with {label}: {first}{more}") from first.__cause__


class Variant(NamedTuple):
    """A plugin, labelled with the setting that differs from its defaults."""

    label: str
    plugin: Plugin


def variants(cls: type[Plugin], settings: Mapping[str, Any]) -> list[Variant]:
    """Return the defaults, then each bound and each choice of each of the plugin's own fields.

    ``settings`` replace the defaults of some of them.
    Values that the plugin's validator rejects with other fields at their defaults are left out.
    """
    # Fields that the contracts declare are not the plugin's own.
    bases = (base for base in cls.__mro__[1:] if base.__module__.startswith("flipperctl.api."))
    shared = {name for base in bases for name in getattr(base, "model_fields", ())}
    try:
        default = cls(**settings)
    except ValidationError as error:
        raise _invalid("its defaults", error) from error
    accepted = [Variant("its defaults", default)]

    # One setting at a time leaves its default, so that a failure names its cause.
    for field in (name for name in cls.model_fields if name not in shared):
        for value in _edges(cls, field):
            if value == getattr(default, field):
                continue
            label = f"{field}={value}"
            try:
                accepted.append(Variant(label, cls(**{**settings, field: value})))
            except ConfigError:  # of a validator, as below
                continue
            except ValidationError as error:
                if error.errors()[0]["type"] != "value_error":
                    raise _invalid(label, error) from error
    return accepted


def _invalid(label: str, error: ValidationError) -> ConformanceError:
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    text = f"{where + ': ' if where else ''}{first['msg']}; the value is {first['input']!r}"
    return ConformanceError(f"with {label}: {text}")


def _edges(cls: type[Plugin], field: str) -> Iterator[Any]:
    """Yield the outermost values that a field's bounds allow, or its choices."""
    # A strict bound is not allowed itself; its nearest neighbour is.
    info = cls.model_fields[field]
    for bound in info.metadata:
        for name, direction in _BOUNDS.items():
            if (value := getattr(bound, name, None)) is None:
                continue
            if _numbers(info.annotation) in ({int}, {IntRange}):
                yield int(value) + direction
            else:
                yield math.nextafter(value, math.inf * direction) if direction else value
    if info.annotation is bool:
        yield from (False, True)
    elif get_origin(info.annotation) is Literal:
        yield from get_args(info.annotation)


def _numbers(annotation: Any) -> set[type]:
    """Return the types of numbers and ranges in a field's annotation or union."""
    union = get_origin(annotation) in (Union, types.UnionType)
    known = {int, float, Range, IntRange}
    return known.intersection(get_args(annotation) if union else (annotation,))


def _registered(cls: type[Plugin]) -> None:
    """Check that the plugin is registered under its name."""
    name = cls.__dict__.get("plugin_name")
    require(name is not None, f"has no name; decorate {cls.__name__} with @{cls.kind}(<name>)")
    registered = registry.get((cls.kind, str(name)))
    require(registered is cls, f"is not the class registered under its name, which is {registered}")


def _documented(cls: type[Plugin]) -> None:
    """Check that the plugin has a docstring, and each field a description, a unit and bounds."""
    # A docstring for people; for each field a unit for tables, and bounds for these checks
    docstring = cls.__dict__.get("__doc__")
    require(bool(inspect.cleandoc(docstring or "").strip()), "has no docstring; describe it")
    for field, info in cls.model_fields.items():
        text = info.description or ""
        require(
            re.search(r"\S \[[^\[\]]+\]$", text) is not None,
            f"has a field {field!r} without a unit: the description is {text!r}; "
            "end it in one, such as [m], or [-] without a dimension",
        )
        if not _numbers(info.annotation):
            continue
        for names, side in ((("ge", "gt"), "ge= or gt="), (("le", "lt"), "le= or lt=")):
            bounded = any(getattr(m, n, None) is not None for m in info.metadata for n in names)
            inside = "; beside other types, Annotated[float, Field(…)] within the union has them"
            require(
                bounded,
                f"has a field {field!r} without a bound on one side: give it {side}"
                f"{inside if set(get_args(info.annotation)) - {type(None)} else ''}",
            )


def _checkpoint(plugin: Plugin) -> None:
    """Check that the plugin is unchanged after it is written as JSON and read again."""
    written = resolver.to_dict(plugin)
    again = resolver.create(plugin.kind, json.loads(json.dumps(written)), plugin.kind)
    require(
        again == plugin and type(again) is type(plugin),
        f"it changes in a checkpoint: {written} becomes {resolver.to_dict(again)}",
    )
