"""Overrides without an effect: those of settings that are sampled anew for every episode."""

from __future__ import annotations

from collections.abc import Mapping

from flipperctl.config.models import EnvConfig
from flipperctl.errors import ConfigError


def check_effect(config: EnvConfig, given: Mapping[str, str]) -> None:
    """Refuse an override of a setting that is sampled anew for every episode.

    ``given`` holds the overridden keys, and the override of each as it was typed.

    With ``randomise.spread``, samples lie around the value of the setting, which then has one. All
    settings of the robot at once are those of a file, ``robot=FILE``, of which some may be sampled.

    Raises:
        ConfigError: an override sets a randomised setting; the text has the range.
    """
    if config.randomise.spread is not None:
        return
    whole = all(f"robot.{field}" in given for field in type(config.robot).model_fields)
    for key, typed in given.items():
        if whole and key.startswith("robot."):
            continue
        for one in config.randomise.sampled():
            # The nominal turning rate still sets the decision period.
            if key == f"{one.section}.{one.field}" and one.field != "flipper_speed":
                value = one.value
                shown = "[{:g},{:g}]".format(*value) if isinstance(value, tuple) else f"{value:g}"
                raise ConfigError(
                    f"{typed}: it has no effect, since {one.key}={shown} "
                    f"samples it for every episode; add {one.key}=null, or change that value"
                )
