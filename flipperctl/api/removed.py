"""Settings of earlier versions, and the value at which each is fixed now.

Files of earlier versions hold them. One that has its value is left out when settings are read; any
other value is refused, since the file then means something else.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any

_REMOVED: Mapping[str, Mapping[str, object]] = {
    "agent": {"act_with": "target"},
    "policy_gradient": {"value_rate": 1e-3, "value_passes": 8},
    "mpc": {"averaging": 0.5},
    "planner": {"stretch": 0.12},
    "planar": {"engine": "compiled"},
    "mujoco": {"ground_width": 4.0, "roll_gain": 0.0, "rotor_inertia": 1.0},
    "lidar": {"wander_time": 30.0},
}
"""Section or plugin → its former settings with their values."""


def removal(owner: str, name: str, key: str | None = None) -> str | None:
    """Return what to say of a setting that is gone, or None if there was no such setting.

    ``owner``: section or plugin. ``key``: the setting as it was written, by default its name.
    """
    gone = _REMOVED.get(owner, {})
    if name not in gone:
        return None
    return f"{key or name} is gone; its value was {gone[name]}"


_COUNTS = ("steps", "hurdles", "plates", "piles", "bars", "blocks", "waves", "obstacles")
"""Numbers of parts that terrains sample; each was two settings, fewest and most."""


def respelling(key: str, known: Collection[str]) -> str | None:
    """Return what to write for a key that was one end of a range, or None if it was not.

    ``known``: the settings beside it, such as ``height`` for ``height_low`` and ``height_high``.
    """
    where, dot, name = key.rpartition(".")
    whole = re.sub("(^|_)(low|high)$", "", name) or "height"  # a step's were low and high
    if name in ("fewest", "most"):
        whole = next((count for count in _COUNTS if count in known), name)
    if whole == name or whole not in known:
        return None
    return f"{key} is gone; write {where}{dot}{whole}=[low,high], or one number for both ends"


def former_names(owner: str, name: str) -> tuple[str, str]:
    """Return the settings that a plugin's range replaced, by which identities still name it."""
    if name in _COUNTS:
        return "fewest", "most"
    before = "" if name == "height" and owner in ("step", "paper_step") else f"{name}_"
    return f"{before}low", f"{before}high"


def without_removed(owner: str, values: Any) -> Any:
    """Return the values of settings without those that are gone and have their last value.

    Raises:
        ValueError: one that is gone has another value.
    """
    gone = _REMOVED.get(owner)
    if gone is None or not isinstance(values, Mapping):
        return values
    for name in gone.keys() & values.keys():
        if values[name] != gone[name]:
            raise ValueError(f"{removal(owner, name)}; it is {values[name]!r} here")
    return {name: value for name, value in values.items() if name not in gone}
