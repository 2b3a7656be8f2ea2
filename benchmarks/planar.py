"""The planar engine's settings, for measures of this engine alone."""

from __future__ import annotations

from flipperctl.api import Engine
from flipperctl.errors import ConfigError
from flipperctl.sim.planar import Planar


def planar(chosen: Engine) -> Planar:
    """Return the settings as those of the planar engine.

    Raises:
        ConfigError: another engine was chosen.
    """
    if not isinstance(chosen, Planar):
        raise ConfigError(f"sim: this is measured with sim=planar only; got {chosen.plugin_name}")
    return chosen
