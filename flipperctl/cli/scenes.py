"""What ``eval`` and ``inspect reward`` evaluate: scenes and whoever drives them."""

from __future__ import annotations

from pathlib import Path

from flipperctl import checkpoint as checkpoints
from flipperctl import plugins
from flipperctl.cli import compose
from flipperctl.config import EvalConfig
from flipperctl.policies.exported import exported_config, is_exported
from flipperctl.policies.source import PolicySource


def scenes(
    overrides: list[str], checkpoint: Path | None, controller: str | None
) -> list[tuple[EvalConfig, PolicySource]]:
    """What to evaluate: a configuration a scene, and the controller; one of the two is given.

    Raises:
        CheckpointError: there is no such policy, or its observation layout is another one.
        ConfigError: an override is wrong.
    """
    compose.offer_defaults()
    if checkpoint is None:
        plugins.get("controller", controller, "--controller")
        found = compose.compose_eval([f"controller={controller}", *overrides])
        return [(config, PolicySource(settings=settings)) for config, settings in found]
    file = checkpoints.find(checkpoint)
    trained = exported_config(file) if is_exported(file) else checkpoints.read(file).config()
    primary = compose.offer_trained(trained)
    source = PolicySource(checkpoint=file)
    configs = [config for config, _ in compose.compose_eval(overrides, primary)]
    for config in configs:
        source.build(config.perception)  # a wrong layout is found before the first episode
    return [(config, source) for config in configs]
