"""The inputs and outputs of an exported policy, from the entries of its metadata.

In: the metadata of an ONNX model, as JSON that is read strictly. Out: an ``Interface``, checked.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation as layout
from flipperctl.core.lidar.ground import MapQuality
from flipperctl.core.observation import ANGLES
from flipperctl.core.risk import LAGS, SCALE, EscapeRule, RiskSign
from flipperctl.core.targets import PAIRS, TargetRule
from flipperctl.errors import OldVersionError, PolicyError
from flipperctl.runtime.session import EXPORT_AGAIN, FORMAT_VERSION, PREFIX


def read_entry(
    metadata: Mapping[str, str],
    where: str,
    name: str,
    allowed: str,
    check: Callable[[Any], bool],
    absent: str = "",
) -> Any:
    """Return the value of an entry after ``check``; ``absent`` is the text of a missing entry.

    Raises:
        PolicyError: the entry is not JSON, or ``check`` rejects it.
    """
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


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_count(value: object) -> bool:
    """Return whether a value is a whole number above 0."""
    return isinstance(value, int) and is_whole(value) and value > 0


def is_number(value: object) -> bool:
    """Return whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= sys.float_info.max  # false for NaN; integers are unbounded


def is_positive(value: object) -> bool:
    """Return whether a value is a finite number above 0."""
    return isinstance(value, int | float) and is_number(value) and value > 0


def is_table(value: object) -> bool:
    """Return whether a value is a table with a row of finite numbers for each action."""
    return (
        isinstance(value, list)
        and len(value) == len(PAIRS.steps)
        and all(
            isinstance(row, list) and len(row) == len(PAIRS.joints) and all(map(is_number, row))
            for row in value
        )
    )


TARGETS = f"{PREFIX}targets"
"""Metadata entry of the rule for the flippers' targets."""
RISK = f"{PREFIX}risk"
"""Metadata entry of the risk, in files whose policy tells one."""
ESCAPE = f"{PREFIX}escape"
"""Metadata entry of how actions are drawn on a warning, in files whose policy does so."""
MAP = f"{PREFIX}map"
"""Metadata entry of the map's settings, in files whose policy was trained with a LiDAR."""


def targets(metadata: Mapping[str, str], where: str) -> TargetRule:
    """Return the rule for the targets."""
    rule = read_entry(
        metadata,
        where,
        TARGETS.removeprefix(PREFIX),
        "a mapping with the angles window and limit, each above 0",
        lambda v: (
            isinstance(v, dict) and all(is_positive(v.get(key)) for key in ("window", "limit"))
        ),
    )
    return TargetRule(window=rule["window"], limit=rule["limit"])


def risk(metadata: Mapping[str, str], where: str) -> RiskSign | None:
    """Return when the risk is a warning; None if the file has no risk."""
    if RISK not in metadata:
        return None
    sign = read_entry(
        metadata,
        where,
        RISK.removeprefix(PREFIX),
        "a mapping with the whole number horizon, the threshold, above 0 and at most 1, the lags "
        f"{list(LAGS)} and the scale {SCALE}",
        lambda v: (
            isinstance(v, dict)
            and is_count(v.get("horizon"))
            and is_positive(v.get("threshold"))
            and v["threshold"] <= 1
            and (v.get("lags"), v.get("scale")) == (list(LAGS), SCALE)
        ),
    )
    return RiskSign(sign["horizon"], float(sign["threshold"]))


def escape(metadata: Mapping[str, str], where: str) -> EscapeRule | None:
    """Return how actions are drawn on a warning; None if they never are."""
    if ESCAPE not in metadata:
        return None
    rule = read_entry(
        metadata,
        where,
        ESCAPE.removeprefix(PREFIX),
        f"a mapping with the temperature, above 0, and the whole number decisions, beside {RISK},",
        lambda v: (
            isinstance(v, dict)
            and is_positive(v.get("temperature"))
            and is_count(v.get("decisions"))
            and RISK in metadata
        ),
    )
    return EscapeRule(float(rule["temperature"]), rule["decisions"])


def map_quality(metadata: Mapping[str, str], where: str) -> MapQuality | None:
    """Return the settings of the training's map; None if the file does not state them."""
    if MAP not in metadata:
        return None
    lengths, counts = ("cell", "lane", "half_width", "noise"), ("keep", "fewest")
    quality = read_entry(
        metadata,
        where,
        MAP.removeprefix(PREFIX),
        f"a mapping with the lengths {', '.join(lengths)}, each above 0, the whole numbers "
        f"{' and '.join(counts)}, each above 0, and deskew, true or false,",
        lambda v: (
            isinstance(v, dict)
            and all(is_positive(v.get(key)) for key in lengths)
            and all(is_count(v.get(key)) for key in counts)
            and isinstance(v.get("deskew"), bool)
        ),
    )
    return MapQuality(
        cell=float(quality["cell"]),
        lane=float(quality["lane"]),
        keep=quality["keep"],
        half_width=float(quality["half_width"]),
        fewest=quality["fewest"],
        noise=float(quality["noise"]),
        deskew=quality["deskew"],
    )


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
    joints: tuple[str, ...]
    """Names of the J joints that an action turns: the pairs ``front`` and ``rear``."""
    actions: NDArray[np.float64]
    """Turns of the joints by each action, (9, J) in frame R [rad]."""
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
    entry = partial(read_entry, metadata, where)
    bins = entry("bins", "a whole number above 0", is_count)
    size = layout.size(bins)
    keys = set(Quantity.__dataclass_fields__)
    observation = entry(
        "observation",
        f"a list of {size} mappings of {', '.join(sorted(keys))} to text",
        lambda v: (
            isinstance(v, list)
            and len(v) == size
            and all(isinstance(e, dict) and set(e) == keys for e in v)
            and all(isinstance(text, str) for e in v for text in e.values())
        ),
    )
    joints = entry(
        "joints",
        f"the list {json.dumps(PAIRS.joints)}, the joints of this version,",
        lambda v: v == list(PAIRS.joints),
    )
    table = entry("actions", f"a table of {len(PAIRS.steps)} pairs of angles", is_table)
    actions = np.array(table, dtype=np.float64)
    actions.setflags(write=False)
    robot = entry(
        "robot",
        "a mapping of names to numbers",
        lambda v: isinstance(v, dict) and all(map(is_number, v.values())),
    )
    terrain = metadata.get(f"{PREFIX}terrain", "")
    terrain_config = entry(
        "terrain_config",
        f"a mapping with the name {terrain!r} and the terrain's fields",
        lambda v: isinstance(v, dict) and v.get("name") == terrain,
    )
    return Interface(
        observation=tuple(Quantity(**e) for e in observation),
        bins=bins,
        bin_width=entry("bin_width", "a length above 0", is_positive),
        frames=entry("frames", "a whole number above 0", is_count),
        joints=tuple(joints),
        actions=actions,
        targets=targets(metadata, where),
        decision_period=entry("decision_period", "a time above 0", is_positive),
        robot=MappingProxyType(robot),
        terrain=terrain,
        terrain_config=MappingProxyType(terrain_config),
        seed=entry("seed", "a whole number", is_whole),
        package_version=metadata.get(f"{PREFIX}package_version", ""),
        plugins=tuple(
            PluginFile(**e)
            for e in entry(
                "plugins",
                "a list of mappings of kind, name and file to text",
                lambda v: isinstance(v, list) and all(map(_is_plugin, v)),
                absent="[]",
            )
        ),
        risk=risk(metadata, where),
        escape=escape(metadata, where),
        map_quality=map_quality(metadata, where),
    )


def _is_plugin(value: object) -> bool:
    return (
        isinstance(value, dict)
        and set(value) == set(PluginFile.__dataclass_fields__)
        and all(isinstance(text, str) for text in value.values())
    )
