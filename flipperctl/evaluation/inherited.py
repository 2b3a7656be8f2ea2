"""The settings that an evaluation inherits from a policy's file.

In: a run, a checkpoint or an exported file. Out: sections as plain data, from which an evaluation
is composed, and lines on missing or different settings.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from flipperctl.api import ObservationLayout, registry
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig, to_dict
from flipperctl.config.absent import AbsentReward, AbsentTerrain
from flipperctl.config.identity import ABSENT, differences
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.policies.source import PolicySource

NOMINAL, TRAINED = "nominal", "trained"
"""The default conditions, and those of a policy's training."""
_CHOSEN = ("sim", "perception", "episode", "randomise")
"""The sections that ``conditions=`` chooses."""
_SHOWN = 3
"""Largest number of settings that a line names."""


@dataclass(frozen=True)
class Inherited:
    """The sections that a policy brings to its evaluation, as plain data."""

    chosen: dict[str, Any]
    """Terrain, robot and rewards, which overrides may replace as a whole."""
    kept: dict[str, Any]
    """Observation layout (of ``perception``) and evaluation settings, in all conditions."""
    nominal: dict[str, Any]
    """The other sections at their defaults."""
    trained: dict[str, Any] | None
    """Engine, sensor and the other sections as in the training; None if the file lacks them."""

    @classmethod
    def of(cls, config: TrainConfig | EvalConfig) -> Inherited:
        """Return the sections of a checkpoint, or of an exported file if it is an EvalConfig."""
        own = to_dict(config.environment())
        own["terrain"] = to_dict(config.terrain, brief=True)
        layout = {name: own["perception"][name] for name in ObservationLayout.model_fields}
        chosen = {name: own.pop(name) for name in ("terrain", "robot", "rewards")}
        kept = {"perception": layout, "eval": to_dict(config.eval)}
        default = to_dict(EvalConfig(terrain=config.terrain))
        nominal = {name: default[name] for name in own if name not in ("sim", "perception")}
        return cls(chosen, kept, nominal, own if isinstance(config, TrainConfig) else None)


def read_config(
    source: PolicySource, terrains: Collection[str | None], tell: Callable[[str], None]
) -> TrainConfig | EvalConfig:
    """Return the configuration of a checkpoint, or the part of it that an exported file holds.

    ``terrains`` are those to be evaluated, None for the file's own. Reward terms whose plugins are
    missing are left out, and ``tell`` is called with a line for each.

    Raises:
        CheckpointError: the file is damaged, or its own terrain is to be evaluated and the plugin
            of that is missing.
    """
    file, found = source.file, source.config()
    absent = found.terrain
    if isinstance(absent, AbsentTerrain):
        name = absent.plugin_name
        named = ("terrain", name) in registry  # and only a terrain inside it is missing
        if any(one is None or (one == name and not named) for one in terrains):
            raise CheckpointError(
                f"{file}: {absent.missing}, or evaluate another one with terrain=NAME"
            )
    for name, term in found.rewards.items():
        if isinstance(term, AbsentReward):
            tell(f"{file}: the return lacks rewards.{name}: {term.missing}")
    present = {k: v for k, v in found.rewards.items() if not isinstance(v, AbsentReward)}
    return found.model_copy(update={"rewards": present})


def explain_missing_training(exported: bool) -> str:
    """Return the error text for ``conditions=trained`` without a training."""
    cause = (
        "an exported file does not hold those of its training; evaluate the checkpoint instead"
        if exported
        else "they are those of a checkpoint's training and need --checkpoint"
    )
    folder = files("flipperctl.configs.conditions")
    known = sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if ".yaml" in f.name)
    return f"conditions: {TRAINED!r} is not known here: {cause}; known: {', '.join(known)}"


def policy_notes(
    path: Path,
    trained: TrainConfig | EvalConfig,
    configs: Iterable[EvalConfig],
    keys: Collection[str],
) -> Iterator[str]:
    """Yield a line on each change of the training's settings that the user did not choose.

    ``path`` names the file and ``trained`` is its own configuration; chosen are the overridden
    ``keys``, and all changes if ``conditions=`` names other conditions than the default ones.
    """
    if isinstance(trained, TrainConfig):
        nominal = [config for config in configs if config.conditions == NOMINAL]
        lines = dict.fromkeys(_training_line(trained, config, keys) for config in nominal)
        yield from (f"{path}: {line}" for line in lines if line)


def _training_line(trained: TrainConfig, config: EvalConfig, keys: Collection[str]) -> str:
    """Return a line on settings of the training that the evaluation changes; empty if none."""
    own = EvalConfig(**{name: getattr(trained, name) for name in EnvConfig.model_fields})
    before, here = Conditions.of(own).settings, Conditions.of(config).settings
    texts = [
        f"{path}={_short(there)} ({_short(None if ours is ABSENT else ours)})"
        for section in _CHOSEN
        for path, there, ours in differences(before[section], here[section], section)
        if there is not ABSENT and not {section, path} & set(keys)
    ]
    if not texts:
        return ""
    more = f" and {len(texts) - _SHOWN} more settings" if len(texts) > _SHOWN else ""
    return (
        f"trained with {', '.join(texts[:_SHOWN])}{more}, evaluated with the values in brackets; "
        f"conditions={TRAINED} keeps those of the training"
    )


def _short(value: object) -> str:
    return json.dumps(value, separators=(",", ":")).strip('"')
