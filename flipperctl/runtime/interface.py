"""The inputs and outputs of an exported policy.

In: the metadata of an ONNX model. Out: an ``Interface``, checked.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.core import observation as layout
from flipperctl.core.actions import PAIRS
from flipperctl.core.escape import EscapeRule
from flipperctl.core.lidar.map_quality import MapQuality
from flipperctl.core.observation import ANGLES
from flipperctl.core.risk import RiskSign
from flipperctl.core.targets import TargetRule
from flipperctl.errors import PolicyError
from flipperctl.runtime import optional
from flipperctl.runtime.checksum import FORMAT_VERSION, PREFIX
from flipperctl.runtime.entries import (
    is_count,
    is_number,
    is_positive,
    is_table,
    is_whole,
    read_entry,
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
    """How an action turns the flippers; see ``states_targets``."""
    states_targets: bool
    """Whether the file states that rule. If not, the policy was trained with targets that were not
    bounded by measured angles, and ``targets.window`` is infinite."""
    decision_period: float
    """Time between two actions [s]."""
    robot: Mapping[str, float]
    """Geometry, masses and speeds of the robot that the policy was trained for, in SI units."""
    terrain: str
    """Name of the terrain plugin of the training."""
    terrain_config: Mapping[str, Any]
    """``name`` and all fields of that plugin; only the name in a file of format 1."""
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
        PolicyError: flipperctl did not write the metadata, their format is unknown, or an entry
            is not valid.
    """
    version = metadata.get(f"{PREFIX}format_version")
    if version not in ("1", str(FORMAT_VERSION)):
        raise PolicyError(
            f"{where} has format version {version!r}; "
            f"this version of flipperctl reads 1 and {FORMAT_VERSION}"
        )
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
        absent=json.dumps(PAIRS.joints),  # as in files of version 0.2
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
        absent=json.dumps({"name": terrain}) if version == "1" else "",
    )
    return Interface(
        observation=tuple(Quantity(**e) for e in observation),
        bins=bins,
        bin_width=entry("bin_width", "a length above 0", is_positive),
        frames=entry("frames", "a whole number above 0", is_count, absent="1"),
        joints=tuple(joints),
        actions=actions,
        targets=optional.targets(metadata, where, robot),
        states_targets=optional.TARGETS in metadata,
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
        risk=optional.risk(metadata, where),
        escape=optional.escape(metadata, where),
        map_quality=optional.map_quality(metadata, where),
    )


def _is_plugin(value: object) -> bool:
    return (
        isinstance(value, dict)
        and set(value) == set(PluginFile.__dataclass_fields__)
        and all(isinstance(text, str) for text in value.values())
    )
