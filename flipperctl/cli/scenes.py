"""The scenes and the policy that ``eval``, ``transfer`` and views of ``inspect`` evaluate.

In: overrides, and a checkpoint or a controller's name. Out: a configuration and a policy's source
for each scene.
"""

from __future__ import annotations

from pathlib import Path

from flipperctl import checkpoint as checkpoints
from flipperctl.cli import compose, config_store
from flipperctl.cli.policy_file import find_policy
from flipperctl.config import resolver
from flipperctl.evaluation.scenes import Scene
from flipperctl.policies.exported import exported_config, is_exported
from flipperctl.policies.source import PolicySource


def scenes(overrides: list[str], checkpoint: Path | None, controller: str | None) -> list[Scene]:
    """Return a configuration and the policy's source for each scene.

    Exactly one of ``checkpoint`` and ``controller`` must be given.

    Raises:
        CheckpointError: there is no such policy, or its observation layout differs.
        ConfigError: an override is wrong.
    """
    config_store.register_defaults()
    if checkpoint is None:
        resolver.get("controller", controller, "--controller")
        found = compose.compose_eval([f"controller={controller}", *overrides])
        return [(config, PolicySource(settings=settings)) for config, settings in found]
    file = find_policy(checkpoint)
    trained = exported_config(file) if is_exported(file) else checkpoints.read(file).config()
    primary = config_store.register_trained(trained)
    source = PolicySource(checkpoint=file)
    configs = [config for config, _ in compose.compose_eval(overrides, primary)]
    for config in configs:
        source.build(config)  # a wrong layout or robot is found before the first episode
    return [(config, source) for config in configs]


def with_engine(overrides: list[str]) -> list[str]:
    """Return the overrides with ``sim=mujoco``, unless they choose an engine."""
    chosen = any(override.lstrip("+").startswith("sim=") for override in overrides)
    return list(overrides) if chosen else ["sim=mujoco", *overrides]
