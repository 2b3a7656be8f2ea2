"""The group ``conditions`` on the command line: the chosen set, and the lines below a table."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from importlib.resources import files

from flipperctl.cli.hydra.overrides import parse_overrides
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions

NOMINAL, TRAINED = "nominal", "trained"
_CHOSEN = ("sim", "perception", "episode", "randomise")
"""The sections that ``conditions=`` chooses."""
_SHOWN = 3
"""Number of settings of a training that a line names."""


def chosen_name(overrides: Sequence[str]) -> str:
    """Return the name of the conditions that the overrides choose."""
    name = NOMINAL
    for override in parse_overrides(overrides):
        if override.key_or_group == "conditions":
            name = NOMINAL if override.is_delete() else str(override.value() or NOMINAL)
    return name


def check_effect(config: EvalConfig, overrides: Sequence[str]) -> None:
    """Refuse an override of a setting that is sampled anew for every episode.

    Raises:
        ConfigError: an override sets a randomised setting; the text has the range.
    """
    for override in parse_overrides(overrides):
        key = override.key_or_group
        for one in config.randomise.sampled():
            # The nominal turning rate still sets the decision period.
            if key == f"{one.section}.{one.field}" and one.field != "flipper_speed":
                value = one.value
                shown = "[{:g},{:g}]".format(*value) if isinstance(value, tuple) else f"{value:g}"
                raise ConfigError(
                    f"{override.input_line}: it has no effect, since {one.key}={shown} "
                    f"samples it for every episode; add {one.key}=null, or change that value"
                )


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


def training_line(trained: TrainConfig, config: EvalConfig, overrides: Sequence[str]) -> str:
    """Return which settings of its training a policy is evaluated without; empty if none.

    Those are conditions that nobody chose: settings among ``overrides`` are left out, and so is all
    where ``conditions=`` names other conditions than the default ones.
    """
    if config.conditions != NOMINAL:
        return ""
    chosen = {override.lstrip("+~").partition("=")[0] for override in overrides}
    own = EvalConfig(**{name: getattr(trained, name) for name in EnvConfig.model_fields})
    before, here = Conditions.of(own).settings, Conditions.of(config).settings
    changed = [
        f"{section}.{name}={_short(before[section][name])} ({_short(here[section].get(name))})"
        for section in _CHOSEN
        if section not in chosen
        for name in before[section]
        if before[section][name] != here[section].get(name) and f"{section}.{name}" not in chosen
    ]
    if not changed:
        return ""
    more = f" and {len(changed) - _SHOWN} more settings" if len(changed) > _SHOWN else ""
    return (
        f"trained with {', '.join(changed[:_SHOWN])}{more}, evaluated with the values in brackets; "
        f"conditions={TRAINED} keeps those of the training"
    )


def _short(value: object) -> str:
    return json.dumps(value, separators=(",", ":")).strip('"')


def condition_lines(scenes: Iterable[tuple[str, int, Conditions]]) -> Iterator[str]:
    """Yield a line for each set of conditions: name, seed, hashes, and the settings in words.

    ``scenes`` holds each scene's terrain, seed and conditions.
    """
    groups: dict[tuple[str, int, str], list[str]] = {}
    for terrain, seed, conditions in scenes:
        key = (conditions.name, seed, conditions.line())
        groups.setdefault(key, []).append(f"{terrain} {conditions.hash}")
    for (name, seed, words), hashes in groups.items():
        unique = ", ".join(dict.fromkeys(hashes))
        yield f"conditions {name}, seed {seed}, {unique}: {words}"
