"""The number that a plugin's ``__call__`` returned: of Python, numpy or torch."""

from __future__ import annotations

from numbers import Real

from flipperctl.api import Plugin
from flipperctl.guard import naming


def as_real(value: object, plugin: Plugin) -> Real | None:
    """Return a real number, or that of an array or tensor of one number; None of anything else.

    Raises:
        PluginFailedError: the code of the value that ``plugin`` returned failed.
    """
    with naming(plugin, "__call__"):
        if getattr(value, "shape", None) == ():
            value = value.item()  # type: ignore[attr-defined]  # arrays and tensors have item()
    return value if isinstance(value, Real) else None
