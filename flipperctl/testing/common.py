"""Checks of plugins of every kind: registration, documentation and serialisation."""

from __future__ import annotations

import inspect
import json
import re

from flipperctl.api import Plugin, registry
from flipperctl.config import resolver
from flipperctl.testing.check import require
from flipperctl.testing.variants import numbers

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
