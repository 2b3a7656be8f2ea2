"""Settings of the planar engine, for benchmarks of this engine alone."""

from __future__ import annotations

from flipperctl.api import Engine
from flipperctl.errors import ConfigError
from flipperctl.sim.planar import Planar


def planar(chosen: Engine) -> Planar:
    """Return the engine if it is the planar one.

    Raises:
        ConfigError: another engine was chosen.
    """
    if not isinstance(chosen, Planar):
        raise ConfigError(f"sim: this is measured with sim=planar only; got {chosen.plugin_name}")
    return chosen
