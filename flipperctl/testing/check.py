"""A check of one plugin: a callable whose error states the fault, its place and the value.

Plugins of every kind are checked for their registration, documentation and serialisation.
"""

from __future__ import annotations

import inspect
import json
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from unittest import SkipTest

from flipperctl.api import Plugin, registry
from flipperctl.config import resolver
from flipperctl.errors import ConformanceError, FlipperctlError
from flipperctl.guard import error_line, error_place, plugin_label
from flipperctl.testing.variants import Variant, numbers


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
        try:
            self.run()
        except ConformanceError as error:
            raise ConformanceError(f"{plugin_label(self.plugin)} {error}") from error.__cause__
        except (SkipTest, KeyboardInterrupt):
            raise
        except BaseException as error:  # the plugin's own code may raise anything
            text = _describe(error, self.plugin)
            raise ConformanceError(f"{plugin_label(self.plugin)} raises {text}") from error

    def __str__(self) -> str:
        """Return kind, plugin and check, as the id of a test."""
        name = getattr(self.plugin, "plugin_name", self.plugin.__name__)
        return f"{self.plugin.kind}-{name}-{self.name}"


def run_on_variants(variants: Sequence[Variant], test: Callable[[Any], None]) -> None:
    """Run a test on every variant of a plugin.

    Raises:
        ConformanceError: a variant fails, or the plugin's own code raises. The text describes the
            first failure and names the other variants that fail.
    """
    failed: list[tuple[str, ConformanceError]] = []
    for variant in variants:
        try:
            test(variant.plugin)
        except ConformanceError as error:
            failed.append((variant.label, error))
        except (SkipTest, KeyboardInterrupt):
            raise
        except BaseException as error:  # noqa: BLE001  # the plugin's own code may raise anything
            failure = ConformanceError(_describe(error, variant.plugin))
            failure.__cause__ = error
            failed.append((variant.label, failure))
    if failed:
        label, first = failed[0]
        others = ", ".join(label for label, _ in failed[1:])
        more = f" (it also fails with {others})" if others else ""
        raise ConformanceError(f"with {label}: {first}{more}") from first.__cause__


def require(holds: bool, text: str) -> None:
    """Raise an error with this text unless the condition holds.

    Raises:
        ConformanceError: the condition does not hold.
    """
    if not holds:
        raise ConformanceError(text)


def _describe(error: BaseException, plugin: Plugin | type[Plugin]) -> str:
    """Return the error in one line, with file and line unless the core raised it."""
    where = "" if isinstance(error, FlipperctlError) else f" ({error_place(error, plugin, '')})"
    return f"{error_line(error)}{where}"


def run_check(one: Check) -> dict[str, Any]:
    """Run one check; return ``ok``, ``skipped``, the message and the time taken [s]."""
    begun, text, ok, skipped = time.perf_counter(), "", True, False
    try:
        one()
    except ConformanceError as error:
        text, ok = str(error), False
    except NotChecked as error:
        text, skipped = str(error), True
    return {
        "kind": one.plugin.kind,
        "name": getattr(one.plugin, "plugin_name", one.plugin.__name__),
        "check": one.name,
        "ok": ok,
        "skipped": skipped,
        "message": text,
        "seconds": time.perf_counter() - begun,
    }


def run_checks(todo: Sequence[Check], report: Callable[[str, float], None]) -> list[dict[str, Any]]:
    """Run every check; ``report`` is given the name of the next one and the finished fraction."""
    rows = []
    for index, one in enumerate(todo):
        report(str(one), index / len(todo))
        rows.append(run_check(one))
    return rows


def require_passed(rows: Sequence[dict[str, Any]]) -> None:
    """Refuse the results of checks of which one failed.

    Raises:
        ConformanceError: a check failed; the text names plugins and checks.
    """
    if failed := [f"{row['kind']} {row['name']} ({row['check']})" for row in rows if not row["ok"]]:
        raise ConformanceError(
            f"{len(failed)} of {len(rows)} checks failed: {', '.join(failed[:10])}"
            + (" …" if len(failed) > 10 else "")
        )


_LOWER, _UPPER = ("ge", "gt"), ("le", "lt")


def registered(cls: type[Plugin]) -> None:
    """Check that the plugin is registered under its name."""
    name = cls.__dict__.get("plugin_name")
    require(name is not None, f"has no name; decorate {cls.__name__} with @{cls.kind}(<name>)")
    found = registry.get((cls.kind, str(name)))
    require(found is cls, f"is not the class registered under its name, which is {found}")


def documented(cls: type[Plugin]) -> None:
    """Check that the plugin has a docstring, and each field a description, a unit and bounds."""
    own = cls.__dict__.get("__doc__")
    require(bool(inspect.cleandoc(own or "").strip()), "has no docstring; describe it")
    for field, info in cls.model_fields.items():
        text = info.description or ""
        require(
            re.search(r"\S \[[^\[\]]+\]$", text) is not None,
            f"has a field {field!r} without a unit: the description is {text!r}; "
            "end it in one, such as [m], or [-] without a dimension",
        )
        if not numbers(info.annotation):
            continue
        for names, side in ((_LOWER, "ge= or gt="), (_UPPER, "le= or lt=")):
            bounded = any(getattr(m, n, None) is not None for m in info.metadata for n in names)
            require(bounded, f"has a field {field!r} without a bound on one side: give it {side}")


def survives_a_checkpoint(plugin: Plugin) -> None:
    """Check that the plugin is unchanged after it is written as JSON and read again."""
    written = resolver.to_dict(plugin)
    again = resolver.create(plugin.kind, json.loads(json.dumps(written)), plugin.kind)
    require(
        again == plugin and type(again) is type(plugin),
        f"it changes in a checkpoint: {written} becomes {resolver.to_dict(again)}",
    )
