"""What identifies a policy wherever its file lies: its content and the seed of its training.

In: a policy's source. Out: a SHA-256 that is equal for equal policies, a name for tables, and the
settings in which trainings of one method agree.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from flipperctl.api import Controller
from flipperctl.checkpoint import find, read_policy
from flipperctl.config import TrainConfig, identity, to_dict
from flipperctl.config.identity import (
    all_files_read,
    content_digest,
    foreign_sources,
)
from flipperctl.errors import CheckpointError
from flipperctl.policies.source import ExportedPolicy, PolicySource

_ATTEMPTS = 10
_DIGITS = 16  # of a digest in a table
_PLACES = ("seed", "device", "collector", "logger")
"""Settings in which the trainings of one method may differ."""
_PACE = ("workers", "threads", "checkpoint_every", "regret_episodes")
"""Settings of ``train`` in which they may differ, since a run may go on elsewhere."""


@dataclass(frozen=True)
class PolicyIdentity:
    """A policy as its results know it."""

    label: str
    """Name for tables; two names may stand for one policy."""
    digest: str
    """SHA-256 of a file's bytes, or of a controller's name, settings and files. The source of a
    plugin that is not part of flipperctl is included."""
    training_seed: int | None
    """Seed of the training; None for a controller plugin."""
    training: Mapping[str, Any] | None = field(default=None, compare=False, repr=False)
    """Settings in which the trainings of its method agree; None unless it is a checkpoint."""

    @classmethod
    def of(cls, source: PolicySource) -> PolicyIdentity:
        """Return the identity of a policy."""
        if source.checkpoint is None:
            return cls(source.label(), _of_controller(source.controller()), None)
        file = source.checkpoint
        digest = ""
        # Digest and settings must be of one file, though a training may replace it in between.
        for _ in range(_ATTEMPTS):
            before, digest = digest, _content(file)
            if digest == before:
                break
            exported = ExportedPolicy(file).interface if source.is_exported else None
            config = read_policy(file).policy_config() if exported is None else None
        else:
            raise CheckpointError(f"{file} is being replaced by another process; try again")
        if exported is not None:
            return cls(source.label(), digest, exported.seed)
        assert config is not None

        # What else the policy acts by counts as well: a network's code and its files.
        files = map(content_digest, all_files_read([config.network]))
        if sources := [*foreign_sources([config.network]), *files]:
            digest = _digest([digest, *sources])
        return cls(source.label(), digest, config.seed, method_settings(config))

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of ``episodes.csv``: digests of the policy and its training, and the seed."""
        columns: dict[str, Any] = {"policy_hash": self.digest[:_DIGITS]}
        if self.training_seed is not None:
            columns["training_seed"] = self.training_seed
        if self.training is not None:
            columns["training_hash"] = _digest(without_input_paths(self.training))[:_DIGITS]
        return columns


def method_settings(config: TrainConfig) -> dict[str, Any]:
    """Return the settings in which the trainings of one method agree."""
    plain = to_dict(config)
    plain["train"] = {name: value for name, value in plain["train"].items() if name not in _PACE}
    return {name: value for name, value in plain.items() if name not in _PLACES}


def without_input_paths(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``method_settings`` in which it does not count from which run or file one learnt.

    Each training seed may go on from a run of its own, or learn from recordings of its own.
    """
    plain = dict(settings)
    for section, key in (("agent", "start_from"), ("teacher", "episodes")):
        if plain.get(section, {}).get(key) is not None:
            plain[section] = {**plain[section], key: "a file of its own"}
    return plain


def _of_controller(controller: Controller) -> str:
    document: dict[str, Any] = identity(controller)
    for key, named in controller.uses().items():  # their content counts, not their place
        document["settings"].pop(key.partition("[")[0], None)
        document[key] = _content(find(Path(named)))
    return _digest([document, *foreign_sources([controller])])


def _content(file: Path) -> str:
    if (digest := content_digest(file)) is None:
        raise CheckpointError(f"{file} cannot be read")
    return digest


def _digest(document: object) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()
