"""Gather what a policy's card tells: from its checkpoint, its run and stored results.

In: a run, a checkpoint or the name of a shipped policy, and folders of ``eval --output``. Out: the
facts of the card.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, strict_yaml
from flipperctl.config.describe import settings
from flipperctl.config.identity import content_digest
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation.result_rows import StoredRow, read_rows
from flipperctl.evaluation.store import FOLDER, played_policies
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource
from flipperctl.report.card import CardFacts
from flipperctl.runs.folder import HYDRA, SUMMARY

_SECTIONS = (
    *("agent", "network", "rewards", "teacher", "train"),
    *("episode", "perception", "robot", "sim", "randomise"),
)
"""Sections whose changed settings the card lists."""


def card_facts(
    policy: Path, file: Path, results: Sequence[Path], commands: Sequence[str] = ()
) -> CardFacts:
    """Return the facts about a policy; ``policy`` is the name or path, ``file`` its checkpoint.

    Raises:
        CheckpointError: the checkpoint cannot be read.
        RequestError: a folder holds no results, or those of another policy.
    """
    saved = checkpoints.read(file)
    config, document = saved.policy_config(), saved.document
    robot = config.robot
    label = PolicySource(checkpoint=file).label()
    return CardFacts(
        name=policy.name if policy.is_dir() else Path(label).stem,
        content=saved.content,
        version=document.versions["flipperctl"],
        network=config.network.plugin_name,
        terrain=config.terrain.plugin_name,
        seed=config.seed,
        decisions=_decisions(saved),
        seconds=_seconds(policy),
        robot=f"chassis {robot.chassis_length:g} m, flippers {robot.flipper_length:g} m, tracks "
        f"{robot.track_speed:g} m/s",
        training=_training(policy),
        settings=_changed(config),
        rows=policy_rows(file, results),
        commands=commands,
    )


def policy_rows(file: Path, results: Sequence[Path]) -> list[StoredRow]:
    """Return the stored results of a policy and its baselines; the label becomes its name.

    Raises:
        RequestError: a folder holds no results, those of another policy, or those of other weights.
    """
    found = []
    for folder in results:
        rows, played = read_rows(folder), played_policies(folder / FOLDER)
        policies = list(dict.fromkeys(row.method for row in rows if row.is_policy))
        others = [method for method in policies if not _is(method, file)]
        if others == policies:
            raise RequestError(f"{folder}: it holds results of {', '.join(others)}, not of {file}")
        if others:
            raise RequestError(
                f"{folder}: it holds results of {', '.join(others)}, too; a card is of one policy "
                "and its baselines: evaluate it with --baseline okada,level, alone"
            )
        for row in rows:
            if not row.is_policy:
                continue
            digests = {one.digest for one in played.get((row.method, row.hash), ())}
            if digests and PolicyIdentity.of(PolicySource(checkpoint=file)).digest not in digests:
                raise RequestError(
                    f"{folder}: {row.method} had other weights there than {file} has now; evaluate "
                    "it again"
                )
        found += rows
    return found


def _is(label: str, file: Path) -> bool:
    """Return whether a label of results names a policy's file, or a file of equal content."""
    if label == PolicySource(checkpoint=file).label():
        return True
    other = Path(label)
    return other.is_file() and content_digest(other) == content_digest(file)


def _decisions(saved: Checkpoint) -> int | None:
    document = saved.document
    if document.decision is not None:
        return document.decision
    return document.state.decision if document.state is not None else None


def _seconds(run: Path) -> float | None:
    """Return the duration of a run's training [s], if its summary is there."""
    try:
        found: Any = json.loads((run / SUMMARY).read_text(encoding="utf-8"))["seconds"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return float(found)


def _training(run: Path) -> str | None:
    """Return the command of a run, from the overrides that were stored with it."""
    try:
        words = strict_yaml.read(run / HYDRA / "overrides.yaml", HYDRA.name)
    except ConfigError:
        return None
    return shlex.join(["flipperctl", "train", *map(str, words or ())])


def _changed(config: TrainConfig) -> dict[str, Any]:
    """Return the settings that differ from their defaults, by path, as JSON."""
    found = {}
    for setting in settings(config):
        chosen = setting.path.partition(".")[0] in _SECTIONS and "[" not in setting.path
        plugin = setting.path == setting.section and setting.path != "teacher.controller"
        if chosen and not plugin and setting.value not in (setting.field.default, {}):
            found[setting.path] = json.dumps(setting.value)
    return found
