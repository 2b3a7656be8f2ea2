"""The group ``conditions`` on the command line: the chosen set, and the lines below a table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from importlib.resources import files

from flipperctl.cli.overrides import parse_overrides
from flipperctl.config import EvalConfig
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions

NOMINAL, TRAINED = "nominal", "trained"


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
        for section, name, ends in config.randomise.ranges():
            # The nominal turning rate still sets the decision period.
            if key == f"{section}.{name}" and name != "flipper_speed":
                shown = "[{:g},{:g}]".format(*ends)
                raise ConfigError(
                    f"{override.input_line}: it has no effect, since randomise.{name}={shown} "
                    f"samples it for every episode; add randomise.{name}=null, or change that range"
                )
        for section, name, probability in config.randomise.probabilities():
            if key == f"{section}.{name}":
                raise ConfigError(
                    f"{override.input_line}: it has no effect, since "
                    f"randomise.{name}={probability:g} samples it for every episode; add "
                    f"randomise.{name}=null, or change that probability"
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
