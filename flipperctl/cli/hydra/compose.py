"""Compose validated configurations from overrides, with Hydra.

In: overrides. Out: a ``TrainConfig`` or ``EvalConfig`` for each combination of the lists among the
overrides. ``config_store`` holds the defaults.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import ConfigCompositionException, MissingConfigException
from omegaconf import DictConfig, OmegaConf

from flipperctl.cli.hydra import config_store, errors
from flipperctl.cli.hydra.config_store import (
    CONFIGS,
    EVAL_CHECKPOINT,
    EVAL_CONTROLLER,
    EVAL_EXPORT,
    strict_files,
)
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig, parse
from flipperctl.config.defaults import missing_entry, refuse_ineffective
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import NOMINAL, TRAINED, explain_missing_training
from flipperctl.terminal.notices import print_notices

Composed = TypeVar("Composed")


def parse_training(composed: DictConfig) -> TrainConfig:
    """Validate the training configuration that Hydra composed."""
    return _training(_plain(composed))


def compose_train(overrides: Overrides = Overrides()) -> list[TrainConfig]:  # noqa: B008  # frozen
    """Return one configuration for each combination of the sweeps in ``overrides``.

    Raises:
        ConfigError: an override is unknown, of the wrong type, out of bounds or without effect.
    """
    found = []
    for combination, plain in _compositions("train", overrides):
        config = _training(plain)
        check_training_effect(config, combination)
        print_notices(config)
        found.append(config)
    return found


def check_training_effect(config: TrainConfig, overrides: Overrides) -> None:
    """Refuse an override of a setting that a training samples anew for every episode.

    Those of the robot have an effect: policies and evaluations assume the configured one.
    """
    typed = overrides.typed.items()
    refuse_ineffective(config, {key: word for key, word in typed if not key.startswith("robot.")})


def run_directory(overrides: Overrides) -> Path:
    """Return the directory of a single run, ``hydra.run.dir``, for overrides that compose."""
    with errors.convert_hydra_errors(), _initialized():
        return Path(compose("train", overrides.words, return_hydra_config=True).hydra.run.dir)


def compose_eval(
    overrides: Overrides, primary: str = EVAL_CONTROLLER
) -> list[tuple[EvalConfig, dict[str, Any] | None]]:
    """Return the configuration of each combination, and the controller's settings, if any."""
    found = []
    for combination, plain in _compositions(primary, overrides):
        settings = with_preset(plain.pop("controller", None), "controller")
        plain["conditions"] = combination.choice("conditions") or NOMINAL
        config = parse(EvalConfig, plain)
        refuse_ineffective(config, combination.typed)
        print_notices(config)
        found.append((config, settings))
    return found


def compose_environment(overrides: Overrides, primary: str = EVAL_CONTROLLER) -> EnvConfig:
    """Return the only configuration of an evaluation, as that of an environment."""
    config, _ = only_one(compose_eval(overrides, primary))
    return config


def with_preset(controller: Any, path: str, primary: str = EVAL_CONTROLLER, *words: str) -> Any:
    """Return a controller's settings, with the terms of the preset if ``rewards`` is its name.

    ``path``: section of the controller. ``words``: overrides on which the preset depends.
    """
    name = controller.get("rewards") if isinstance(controller, dict) else None
    if not isinstance(name, str):
        return controller
    config_store.register_defaults()
    with _initialized():
        options = GlobalHydra.instance().config_loader().get_group_options("rewards")
        if name not in (known := [option for option in options if option[0] != "_"]):
            raise missing_entry("rewards", name, known, f"{path}.rewards")
        composed = _plain(compose(primary, [f"rewards={name}", *words]))
    return {**controller, "rewards": composed["rewards"]}


def only_one(found: Sequence[Composed]) -> Composed:
    """Return the only configuration, for commands that take just one."""
    if len(found) > 1:
        raise ConfigError(
            f"the lists among the overrides give {len(found)} configurations; this command takes "
            "one configuration"
        )
    return found[0]


def _compositions(primary: str, overrides: Overrides) -> Iterator[tuple[Overrides, dict[str, Any]]]:
    """Yield each combination of the sweeps, and its composed configuration."""
    config_store.register_defaults()
    with errors.convert_hydra_errors(), _initialized():
        for combination in overrides.combinations():
            if primary != EVAL_CHECKPOINT and combination.choice("conditions") == TRAINED:
                raise ConfigError(explain_missing_training(exported=primary == EVAL_EXPORT))
            try:
                yield combination, _plain(compose(primary, combination.words))
            except MissingConfigException as error:
                raise errors.missing_choice(error) from error
            except ConfigCompositionException as error:
                raise errors.unknown_key(error, primary, combination) from error


@contextmanager
def _initialized() -> Iterator[None]:
    """Let Hydra compose in the body.

    Within an application of Hydra, which knows --config-dir, it does so already.
    """
    if GlobalHydra.instance().is_initialized():
        yield
        return
    with strict_files(), initialize_config_dir(CONFIGS, version_base="1.3"):
        yield


def _training(plain: dict[str, Any]) -> TrainConfig:
    teacher, agent = plain.get("teacher"), plain.get("agent")
    if isinstance(teacher, dict) and isinstance(agent, dict) and "controller" in teacher:
        gamma = f"agent.gamma={agent.get('gamma')}"
        found = with_preset(teacher["controller"], "teacher.controller", "train", gamma)
        plain = {**plain, "teacher": {**teacher, "controller": found}}
    return parse(TrainConfig, {"logger": {}, **plain})


def _plain(composed: DictConfig) -> dict[str, Any]:
    with errors.convert_hydra_errors():
        plain = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    if not isinstance(plain, dict):
        raise ConfigError("the configuration is not a mapping")
    # Without this key, the model's defaults would replace the terms dropped by ~rewards.
    return {"rewards": {}, **{str(k): v for k, v in plain.items() if k != "hydra"}}
