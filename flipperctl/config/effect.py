"""Overrides without an effect: those of settings that are sampled anew for every episode."""

from __future__ import annotations

from collections.abc import Mapping

from flipperctl.config.models import EnvConfig
from flipperctl.errors import ConfigError


def check_effect(config: EnvConfig, given: Mapping[str, str]) -> None:
    """Refuse an override of a setting that is sampled anew for every episode.

    ``given`` holds the overridden keys, and the override of each as it was typed.

    Raises:
        ConfigError: an override sets a randomised setting; the text has the range.
    """
    for key, typed in given.items():
        for section, name, ends in config.randomise.ranges():
            # The nominal turning rate still sets the decision period.
            if key == f"{section}.{name}" and name != "flipper_speed":
                shown = "[{:g},{:g}]".format(*ends)
                raise ConfigError(
                    f"{typed}: it has no effect, since randomise.{name}={shown} "
                    f"samples it for every episode; add randomise.{name}=null, or change that range"
                )
        for section, name, probability in config.randomise.probabilities():
            if key == f"{section}.{name}":
                raise ConfigError(
                    f"{typed}: it has no effect, since "
                    f"randomise.{name}={probability:g} samples it for every episode; add "
                    f"randomise.{name}=null, or change that probability"
                )
