"""The scenes and the policy that ``eval``, ``transfer`` and views of ``inspect`` evaluate.

In: overrides, and a checkpoint or a controller's name. Out: a configuration and a policy's source
for each scene.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from flipperctl import checkpoint as checkpoints
from flipperctl.api import registry
from flipperctl.cli.conditions import training_line
from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.combinations import combinations
from flipperctl.cli.hydra.errors import convert_hydra_errors
from flipperctl.cli.hydra.overrides import check_words, parse_overrides
from flipperctl.cli.policy_file import find_policy
from flipperctl.config import EvalConfig, TrainConfig, resolver
from flipperctl.config.absent import AbsentReward, AbsentTerrain
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.scenes import Scene
from flipperctl.policies.exported import ExportedPolicy, exported_config, is_exported
from flipperctl.policies.source import PolicySource


def scenes(overrides: list[str], checkpoint: Path | None, controller: str | None) -> list[Scene]:
    """Return a configuration and the policy's source for each scene.

    Exactly one of ``checkpoint`` and ``controller`` must be given.

    Raises:
        CheckpointError: there is no such policy, its observation layout differs, or the plugin of
            its training's terrain is missing and no other terrain is chosen.
        ConfigError: an override is wrong.
    """
    config_store.register_defaults()
    if checkpoint is None:
        resolver.get("controller", controller, "--controller")
        found = compose.compose_eval([f"controller={controller}", *overrides])
        return [(config, PolicySource(settings=settings)) for config, settings in found]
    return _scenes_of_file(checkpoint, overrides)


def _scenes_of_file(checkpoint: Path, overrides: Sequence[str]) -> list[Scene]:
    file = find_policy(checkpoint)
    trained = exported_config(file) if is_exported(file) else checkpoints.read(file).policy_config()
    _require_terrain(trained, overrides, file)
    primary = config_store.register_trained(_without_absent_rewards(trained, file))
    source = PolicySource(checkpoint=file)
    configs = [config for config, _ in compose.compose_eval(overrides, primary)]
    # A wrong layout or robot is found before the first episode.
    built = [source.build(config) for config in configs]
    if isinstance(trained, TrainConfig):
        lines = [training_line(trained, config, overrides) for config in configs]
        for line in filter(None, dict.fromkeys(lines)):
            print(f"{checkpoint}: {line}", file=sys.stderr)
    if any(isinstance(p, ExportedPolicy) and not p.interface.states_targets for p in built):
        print(
            f"{file} does not state how a blocked flipper is turned: here its target stays within "
            "robot.angle_step of the measured angle, on a robot nothing bounds it; export it again",
            file=sys.stderr,
        )
    return [(config, source) for config in configs]


def _require_terrain(
    trained: TrainConfig | EvalConfig, overrides: Sequence[str], file: Path
) -> None:
    """Check that the terrain of the training is there, unless another one is evaluated.

    Raises:
        CheckpointError: it is not; the text has the file of its plugin, if it is known.
    """
    absent = trained.terrain
    if not isinstance(absent, AbsentTerrain):
        return
    check_words(overrides)
    with convert_hydra_errors():
        chosen = [_terrain(combination) for combination in combinations(overrides)]
    named = ("terrain", absent.plugin_name) in registry  # and only a terrain inside it is missing
    if any(name is None or (name == absent.plugin_name and not named) for name in chosen):
        raise CheckpointError(
            f"{file}: {absent.missing}, or evaluate another one with terrain=NAME"
        )


def _terrain(combination: Sequence[str]) -> str | None:
    """Return the terrain that overrides choose, or None."""
    found = [o.value() for o in parse_overrides(combination) if o.key_or_group == "terrain"]
    return str(found[-1]) if found else None


def _without_absent_rewards(
    trained: TrainConfig | EvalConfig, file: Path
) -> TrainConfig | EvalConfig:
    """Return the configuration without reward terms whose plugins are missing, and say so."""
    present = {k: v for k, v in trained.rewards.items() if not isinstance(v, AbsentReward)}
    for name, term in trained.rewards.items():
        if isinstance(term, AbsentReward):
            print(f"{file}: the return lacks rewards.{name}: {term.missing}", file=sys.stderr)
    return trained.model_copy(update={"rewards": present})


def with_engine(overrides: list[str]) -> list[str]:
    """Return the overrides with ``sim=mujoco``, unless they choose an engine."""
    chosen = any(override.lstrip("+").startswith("sim=") for override in overrides)
    return list(overrides) if chosen else ["sim=mujoco", *overrides]
