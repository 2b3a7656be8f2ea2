"""What ``eval`` and ``inspect reward`` evaluate: scenes and whoever drives them."""

from __future__ import annotations

from pathlib import Path

from flipperctl import checkpoint as checkpoints
from flipperctl.cli import compose, config_store
from flipperctl.config import EvalConfig, resolver
from flipperctl.policies.exported import exported_config, is_exported
from flipperctl.policies.trained import ControllerSource


def scenes(
    overrides: list[str], checkpoint: Path | None, controller: str | None
) -> list[tuple[EvalConfig, ControllerSource]]:
    """What to evaluate: a configuration a scene, and the controller; one of the two is given.

    Raises:
        CheckpointError: there is no such policy, or its observation layout is another one.
        ConfigError: an override is wrong.
    """
    config_store.offer_defaults()
    if checkpoint is None:
        resolver.get("controller", controller, "--controller")
        found = compose.compose_eval([f"controller={controller}", *overrides])
        return [(config, ControllerSource(settings=settings)) for config, settings in found]
    file = checkpoints.find(checkpoint)
    trained = exported_config(file) if is_exported(file) else checkpoints.read(file).config()
    primary = config_store.offer_trained(trained)
    source = ControllerSource(checkpoint=file)
    configs = [config for config, _ in compose.compose_eval(overrides, primary)]
    for config in configs:
        source.make(config.perception)  # a wrong layout is found before the first episode
    return [(config, source) for config in configs]
