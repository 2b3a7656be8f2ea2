"""The inputs and outputs of an exported policy, from the entries of its metadata.

In: the metadata of an ONNX model, as JSON that is read strictly. Out: an ``Interface``, checked.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation as layout
from flipperctl.core.lidar.ground import MapQuality
from flipperctl.core.observation import ANGLES
from flipperctl.core.risk import LAGS, SCALE, EscapeRule, RiskSign
from flipperctl.core.targets import ACTIONS, JOINTS, TargetRule
from flipperctl.errors import OldVersionError, PolicyError
from flipperctl.runtime.session import EXPORT_AGAIN, FORMAT_VERSION, PREFIX

Check = Callable[[Any], bool]


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_count(value: Any) -> bool:
    return _is_whole(value) and value > 0


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max  # false for NaN; integers are unbounded


def _is_positive(value: Any) -> bool:
    return _is_number(value) and bool(value > 0)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _has(value: Any, checks: Mapping[str, Check], *, alone: bool = False) -> bool:
    """Return whether a value is a mapping with these entries; ``alone``: and no others."""
    return (
        isinstance(value, dict)
        and (not alone or value.keys() == checks.keys())
        and all(check(value.get(name)) for name, check in checks.items())
    )


def _is_list(value: Any, check: Check, length: int | None = None) -> bool:
    """Return whether a value is a list, of this length, of what passes the check."""
    return isinstance(value, list) and length in (None, len(value)) and all(check(v) for v in value)


LARGEST_ANGLE = math.pi
"""Largest angle of an observation, both ways [rad]; a larger one is probably in degrees."""
LARGEST_HEIGHT = 5.0
"""Largest height of an observation, plus half the length of the perceived ground [m].

No passable ground is as high or as deep. The limit detects heights in wrong units: level ground is
about -10 in centimetres and -100 in millimetres.
"""


@dataclass(frozen=True)
class Quantity:
    """One number of an observation."""

    name: str
    unit: str
    frame: str
    """Frame of reference. L: level, at the chassis centre; R: fixed to the chassis."""
    meaning: str


@dataclass(frozen=True)
class PluginFile:
    """A plugin of the training that was loaded from a file, not from an installed package."""

    kind: str
    name: str
    file: str
    """Name of the file, without its folder."""


@dataclass(frozen=True, eq=False)
class Interface:
    """The inputs and outputs of an exported policy, read from its metadata."""

    observation: tuple[Quantity, ...]
    """The N + 3 numbers of one observation, in their order."""
    bins: int
    """N, the number of terrain heights in an observation."""
    bin_width: float
    """Width of a bin [m]."""
    frames: int
    """Number of consecutive observations that form one input of the network, oldest first."""
    actions: NDArray[np.float64]
    """Turns of the front and rear pairs by each action, (9, 2) in frame R [rad]."""
    targets: TargetRule
    """How an action turns the flippers."""
    decision_period: float
    """Time between two actions [s]."""
    robot: Mapping[str, float]
    """Geometry, masses and speeds of the robot that the policy was trained for, in SI units."""
    terrain: str
    """Name of the terrain plugin of the training."""
    terrain_config: Mapping[str, Any]
    """``name`` and all fields of that plugin."""
    seed: int
    """Seed of the training."""
    package_version: str
    """Version of flipperctl that exported the policy."""
    plugins: tuple[PluginFile, ...] = ()
    """Plugins of the training that were not installed; a robot needs none of them."""
    risk: RiskSign | None = None
    """When the policy's risk is a warning; None for a policy that tells none."""
    escape: EscapeRule | None = None
    """How actions are drawn on a warning; None for a policy that never draws them."""
    map_quality: MapQuality | None = None
    """Settings of the map in the training; None for a policy that was trained without a LiDAR."""

    @property
    def size(self) -> int:
        """Length of one observation."""
        return len(self.observation)

    @property
    def limits(self) -> NDArray[np.float64]:
        """Largest plausible magnitudes of the numbers of one observation, (N + 3,) [m, rad]."""
        highest = LARGEST_HEIGHT + layout.reach(self.bins, self.bin_width)
        return np.array([highest] * self.bins + [LARGEST_ANGLE] * len(ANGLES))

    @property
    def inputs(self) -> int:
        """Length of one input of the network: frames · (N + 3)."""
        return self.frames * self.size


_RISK = {
    "horizon": _is_count,
    "threshold": lambda v: _is_positive(v) and v <= 1,
    "lags": lambda v: v == list(LAGS),
    "scale": lambda v: v == SCALE,
}
_MAP = {
    **dict.fromkeys(("cell", "lane", "half_width", "noise"), _is_positive),
    **dict.fromkeys(("keep", "fewest"), _is_count),
    "deskew": lambda v: isinstance(v, bool),
}


def read_interface(metadata: Mapping[str, str], where: str) -> Interface:
    """Return the interface that the metadata of a model describe.

    ``where``: name of the file, for the errors.

    Raises:
        PolicyError: flipperctl did not write the metadata, they are of an earlier version, or an
            entry is not valid.
    """
    version = metadata.get(f"{PREFIX}format_version")
    if version != str(FORMAT_VERSION):
        raise PolicyError(
            f"{where} has format version {version!r}; "
            f"this version of flipperctl reads {FORMAT_VERSION}"
        )
    if f"{PREFIX}joints" not in metadata:
        raise PolicyError(f"{where} {OldVersionError('0.2', EXPORT_AGAIN)}")

    def entry(name: str, allowed: str, check: Check, absent: str = "") -> Any:
        """Return an entry's value after ``check``; ``absent`` is the text of a missing one."""
        text = metadata.get(f"{PREFIX}{name}", absent)
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = None
        if value is None or not check(value):
            raise PolicyError(
                f"{where}: {PREFIX}{name} is {text[:60]!r} in its metadata; {allowed} is allowed"
            )
        return value

    def optional(name: str, allowed: str, checks: Mapping[str, Check]) -> dict[str, Any] | None:
        """Return the named parts of an entry; None if the file does not have it."""
        if f"{PREFIX}{name}" not in metadata:
            return None
        value = entry(name, f"a mapping with {allowed}", lambda v: _has(v, checks))
        return {key: value[key] for key in checks}

    bins = entry("bins", "a whole number above 0", _is_count)
    size = layout.size(bins)
    quantity = dict.fromkeys(Quantity.__dataclass_fields__, _is_text)
    observation = entry(
        "observation",
        f"a list of {size} mappings of {', '.join(sorted(quantity))} to text",
        lambda v: _is_list(v, lambda e: _has(e, quantity, alone=True), size),
    )
    entry(
        "joints",
        f"the list {json.dumps(JOINTS)}, the joints of this version,",
        lambda v: v == list(JOINTS),
    )
    turns, pairs = len(ACTIONS), len(JOINTS)
    table = entry(
        "actions",
        f"a table of {turns} pairs of angles",
        lambda v: _is_list(v, lambda row: _is_list(row, _is_number, pairs), turns),
    )
    actions = np.array(table, dtype=np.float64)
    actions.setflags(write=False)
    angles = dict.fromkeys(("window", "limit"), _is_positive)
    rule = entry(
        "targets",
        "a mapping with the angles window and limit, each above 0",
        lambda v: _has(v, angles),
    )
    robot = entry(
        "robot",
        "a mapping of names to numbers",
        lambda v: isinstance(v, dict) and all(map(_is_number, v.values())),
    )
    terrain = metadata.get(f"{PREFIX}terrain", "")
    terrain_config = entry(
        "terrain_config",
        f"a mapping with the name {terrain!r} and the terrain's fields",
        lambda v: _has(v, {"name": lambda name: name == terrain}),
    )
    plugin = dict.fromkeys(PluginFile.__dataclass_fields__, _is_text)
    plugins = entry(
        "plugins",
        "a list of mappings of kind, name and file to text",
        lambda v: _is_list(v, lambda e: _has(e, plugin, alone=True)),
        absent="[]",
    )
    sign = optional(
        "risk",
        "the whole number horizon, the threshold, above 0 and at most 1, the lags "
        f"{list(LAGS)} and the scale {SCALE}",
        _RISK,
    )
    warns = sign is not None
    escape = optional(
        "escape",
        f"the temperature, above 0, and the whole number decisions, beside {PREFIX}risk,",
        {"temperature": lambda v: _is_positive(v) and warns, "decisions": _is_count},
    )
    quality = optional(
        "map",
        "the lengths cell, lane, half_width, noise, each above 0, the whole numbers keep and "
        "fewest, each above 0, and deskew, true or false,",
        _MAP,
    )
    return Interface(
        observation=tuple(Quantity(**e) for e in observation),
        bins=bins,
        bin_width=entry("bin_width", "a length above 0", _is_positive),
        frames=entry("frames", "a whole number above 0", _is_count),
        actions=actions,
        targets=TargetRule(window=rule["window"], limit=rule["limit"]),
        decision_period=entry("decision_period", "a time above 0", _is_positive),
        robot=MappingProxyType(robot),
        terrain=terrain,
        terrain_config=MappingProxyType(terrain_config),
        seed=entry("seed", "a whole number", _is_whole),
        package_version=metadata.get(f"{PREFIX}package_version", ""),
        plugins=tuple(PluginFile(**e) for e in plugins),
        risk=None if sign is None else RiskSign(sign["horizon"], float(sign["threshold"])),
        escape=None if escape is None else EscapeRule(**escape),
        map_quality=None if quality is None else MapQuality(**quality),
    )
