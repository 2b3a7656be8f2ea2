"""The cells of an evaluation: ranges of episodes of one policy on one scene, and their keys.

In: a configuration and a policy's identity. Out: keys that are equal exactly where results are
equal, whatever plays them, and the header of a cell's file.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import flipperctl
from flipperctl.config import EvalConfig, to_dict
from flipperctl.config.identity import content_digest, foreign_sources, read_files
from flipperctl.env.metrics import measures
from flipperctl.evaluation.conditions import Conditions
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.sim.versions import engine_versions

FORMAT = 1
"""Number of the format of a cell's file."""
_LONG, _SHORT = 16, 8
"""Digits of the hashes within a key."""
_LIBRARIES = ("numpy", "torch")
_GIT_PATIENCE = 5.0  # [s]


@dataclass(frozen=True)
class Series:
    """The episodes of one policy on one scene with one seed, however many: a row of cells."""

    policy: PolicyIdentity
    ground: str
    """What is equal for all policies on equal episodes; see ``ground``."""
    scoring: str
    """SHA-256 of what else a result depends on: rewards, measures and the observation layout."""
    config: EvalConfig = field(compare=False, repr=False)

    @classmethod
    def of(cls, config: EvalConfig, policy: PolicyIdentity) -> Series:
        """Return the series of a policy's episodes under a configuration.

        Raises:
            PluginError: a setting of the terrain cannot be written as JSON.
        """
        return cls(policy, ground(config), _digest(_scoring(config)), config)

    @property
    def key(self) -> str:
        """The key of the series: a cell's name without its range of episodes."""
        training = "x" if self.policy.training_seed is None else self.policy.training_seed
        return f"{self.policy.digest[:_LONG]}.{training}.{self.ground}.{self.scoring[:_SHORT]}"

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the packages on which episodes that are played here depend, by name."""
        return versions_here(self.config)

    def header(self, first: int, last: int) -> dict[str, Any]:
        """Return the header of the cell with the episodes from ``first`` to ``last``."""
        conditions = Conditions.of(self.config)
        return {
            "record": "cell",
            "format": FORMAT,
            "cell": cell_name(self.key, first, last),
            "policy": self.policy.digest,
            "training_seed": self.policy.training_seed,
            "training": self.policy.training,
            "controller": self.policy.label,
            "scene": self.config.terrain.plugin_name,
            "conditions": conditions.name,
            "conditions_hash": conditions.hash,
            "engine": self.config.sim.plugin_name,
            "evaluation_seed": self.config.eval.seed,
            "first": first,
            "last": last,
            "settings": {**conditions.settings, **_scoring(self.config)},
            "versions": self.versions,
            "commit": commit(),
        }


def versions_here(config: EvalConfig) -> dict[str, str]:
    """Return the versions of the packages on which the episodes depend if played here, by name."""
    return {
        "flipperctl": flipperctl.__version__,
        **{name: version(name) for name in _LIBRARIES},
        **engine_versions(config.sim),
    }


def ground(config: EvalConfig) -> str:
    """Return the part of a key that is equal for all policies on equal episodes.

    It has a hash of terrain, robot, physics, sensing, start and randomisation, and the seed of the
    evaluation.
    """
    plugged = [config.terrain, config.sim, config.perception]
    digest = _digest([Conditions.of(config).settings, foreign_sources(plugged)])
    return f"{digest[:_LONG]}.{config.eval.seed}"


def cell_name(key: str, first: int, last: int) -> str:
    """Return the name of the cell with the episodes from ``first`` to ``last``."""
    return f"{key}.{first:06d}-{last:06d}"


def cut(indices: Sequence[int], size: int) -> Iterator[list[int]]:
    """Yield the cells of ascending indices: runs without a gap that pass no multiple of ``size``.

    The ends depend on the indices alone, so that any number of processes writes equal files.
    """
    cell: list[int] = []
    for index in indices:
        if cell and (index != cell[-1] + 1 or index % size == 0):
            yield cell
            cell = []
        cell.append(index)
    if cell:
        yield cell


@cache
def commit() -> str | None:
    """Return the commit of the checkout that runs; None for an installed package."""
    root = Path(flipperctl.__file__).parents[1]
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        done = subprocess.run(  # noqa: S603 - all words are our own
            command, capture_output=True, text=True, timeout=_GIT_PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def _scoring(config: EvalConfig) -> dict[str, Any]:
    """Return what results depend on besides the conditions, as plain data."""
    whole = to_dict(config.environment())
    found = measures()
    read = [file for one in [*config.rewards.values(), *found.values()] for file in read_files(one)]
    return {
        **({"files": [content_digest(file) for file in read]} if read else {}),
        "rewards": whole["rewards"],
        "layout": {name: whole["perception"][name] for name in ("bins", "bin_width")},
        "measures": {name: to_dict(measure) for name, measure in found.items()},
        "sources": foreign_sources([*config.rewards.values(), *found.values()]),
    }


def _digest(document: object) -> str:
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
