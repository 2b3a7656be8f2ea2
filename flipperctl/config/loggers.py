"""The choice of a training's loggers by their names."""

from __future__ import annotations

METRICS_ALONE = "csv"
"""Choice that adds nothing to ``metrics.csv``, which every run writes."""


def by_name(value: object) -> object:
    """Return a mapping of settings for a name or a list of names; other values unchanged."""
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        return value
    return {name: {"name": name} for name in names if name != METRICS_ALONE}
