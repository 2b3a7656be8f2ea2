"""Compose validated configurations from overrides, with Hydra.

In: overrides, the registry, the models' defaults, a policy's configuration. Out: a ``TrainConfig``
or ``EvalConfig`` for each combination of the lists among the overrides. Files, such as those of
``--config-dir``, are read by Hydra.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_origin

from hydra import compose, initialize_config_dir
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.errors import ConfigCompositionException, MissingConfigException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, OmegaConf

from flipperctl.api import Learner, ObservationLayout, Plugin, Robot, registry
from flipperctl.cli.hydra import errors
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import (
    DEFAULT_ENGINE,
    EnvConfig,
    EvalConfig,
    TrainConfig,
    parse,
    presets,
    to_dict,
)
from flipperctl.config.defaults import LISTS, entries, missing_entry, refuse_ineffective, sections
from flipperctl.config.sampled import OMITTED, PATH_SECTIONS
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import NOMINAL, TRAINED, Inherited, explain_missing_training
from flipperctl.terminal.streams import print_notices
from flipperctl.training.search import SearchSettings

CONFIGS = str(resources.files("flipperctl.configs"))
EVAL_CONTROLLER = "eval"
"""Primary configuration of an evaluation of a controller."""
_CHECKPOINT, _EXPORT = "flipperctl_eval_trained", "flipperctl_eval_exported"
"""Those of an evaluation of a checkpoint and of an exported file."""
_ROBOT = "flipperctl_eval_robot"
"""That of an evaluation of a controller with a robot that a file describes."""
_TRAINED = "_trained"  # terrain, robot and rewards of a policy, as group entries
_registered: dict[tuple[str, str], type[Plugin]] = {}
_SWEEPERS = "hydra_plugins.flipperctl_sweepers"
Composed = TypeVar("Composed")


def register_defaults() -> None:
    """Store the defaults of every registered plugin and every section in the ConfigStore.

    Do nothing if no plugin has been registered since the last call.
    """
    if _registered == registry:
        return
    store = ConfigStore.instance()
    for group, name, node in entries():
        # Several entries of a list may be chosen; an entry without settings adds nothing.
        package = f"{group}.{name}" if group in LISTS and node else None
        if group == Learner.kind:
            fields = node.get(group, node)
            if fields is not node:  # it chooses its network, too
                package = "_global_"
            for key, info in registry[group, name].model_fields.items():
                if get_origin(info.annotation) is dict:  # it takes new keys without a +
                    own = info.get_default(call_default_factory=True)
                    fields[key] = OmegaConf.create(own, flags={"struct": False})
        store.store(group=group, name=name, node=node, package=package)
    store.store(name="flipperctl_train", node=_with_paths(sections(TrainConfig)))
    store.store(name="flipperctl_eval", node=_with_paths(sections(EvalConfig)))
    _registered.clear()
    _registered.update(registry)


def _with_paths(sections: dict[str, Any]) -> dict[str, Any]:
    """Return the sections, with the mappings of ``randomise`` open for new keys without a +."""
    randomise = sections["randomise"]
    open_for_keys = {
        section: OmegaConf.create(randomise.get(section, {}), flags={"struct": False})
        for section in PATH_SECTIONS
    }
    return {**sections, "randomise": {**OMITTED, **randomise, **open_for_keys}}


def register_trained(config: TrainConfig | EvalConfig) -> str:
    """Register the evaluation of a policy as a primary configuration; return its name.

    The sections of its training become ``conditions=trained``, unless the file lacks them.
    """
    store = ConfigStore.instance()
    found = Inherited.of(config)
    for group, node in found.chosen.items():
        store.store(group=group, name=_TRAINED, node=node)
    primary, plugins = _EXPORT, ("sim", "perception")
    if found.trained is not None:
        primary, own = _CHECKPOINT, dict(found.trained)
        for group in plugins:
            store.store(group=group, name=_TRAINED, node=own.pop(group))
        choices = [{f"override /{group}": _TRAINED} for group in plugins]
        node = {"defaults": choices, **_with_paths(own)}
        store.store(group="conditions", name=TRAINED, node=node, package="_global_")
    # Later entries override earlier ones.
    defaults = [
        *({group: _TRAINED} for group in found.chosen),
        *({group: DEFAULT_ENGINE} for group in plugins),
        *("_self_", {"conditions": NOMINAL}),
    ]
    nominal = _with_paths(found.nominal)
    store.store(name=primary, node={"defaults": defaults, **nominal, **found.kept})
    return primary


def register_robot(robot: Robot, layout: ObservationLayout | None = None) -> str:
    """Register the evaluation of another robot as a primary configuration; return its name.

    ``layout`` is its observation layout, if that differs as well. Overrides change both.
    """
    chosen = {"override /robot": _TRAINED}
    node: dict[str, Any] = {"defaults": [EVAL_CONTROLLER, "_self_", chosen]}
    if layout is not None:
        node["perception"] = to_dict(layout)
    store = ConfigStore.instance()
    store.store(group="robot", name=_TRAINED, node=to_dict(robot))
    store.store(name=_ROBOT, node=node)
    return _ROBOT


def register_sweepers() -> None:
    """Register ``hydra/sweeper=optuna``, and our sweeper over lists as ``hydra/sweeper=basic``.

    Hydra discovers the classes themselves (see ``hydra_plugins``). Their names are registered here,
    for this process alone; other Hydra applications keep their own ``basic`` and ``optuna``.
    """
    Plugins.instance()  # the discovery registers Hydra's own entries, which ours replace
    settings: dict[str, dict[str, Any]] = {
        "basic": {"_target_": f"{_SWEEPERS}.ListSweeper", "max_batch_size": None, "params": None},
        "optuna": {"_target_": f"{_SWEEPERS}.OptunaSweeper", **SearchSettings().model_dump()},
    }
    for name, node in settings.items():
        ConfigStore.instance().store(group="hydra/sweeper", name=name, node=node)


def compose_train(overrides: Overrides = Overrides()) -> list[TrainConfig]:  # noqa: B008  # frozen
    """Return one configuration for each combination of the sweeps in ``overrides``.

    Raises:
        ConfigError: an override is unknown, of the wrong type, out of bounds or without effect.
    """
    found = []
    for combination, composed in _compositions("train", overrides):
        config = parse_training(composed)
        check_training_effect(config, combination)
        print_notices(config)
        found.append(config)
    return found


def parse_training(composed: DictConfig) -> TrainConfig:
    """Validate the training configuration that Hydra composed."""
    plain = _plain(composed)
    teacher, agent = plain.get("teacher"), plain.get("agent")
    if isinstance(teacher, dict) and isinstance(agent, dict) and "controller" in teacher:
        gamma = f"agent.gamma={agent.get('gamma')}"
        own = with_preset(teacher["controller"], "teacher.controller", "train", gamma)
        plain = {**plain, "teacher": {**teacher, "controller": own}}
    return parse(TrainConfig, {"logger": {}, **plain})


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
    for combination, composed in _compositions(primary, overrides):
        plain = _plain(composed)
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
    register_defaults()
    with _initialized():
        options = GlobalHydra.instance().config_loader().get_group_options("rewards")
        if name not in (known := [option for option in options if option[0] != "_"]):
            raise missing_entry("rewards", name, known, f"{path}.rewards")
        composed = _plain(compose(primary, [f"rewards={name}", *words]))
    return {**controller, "rewards": composed["rewards"]}


def only_one(composed: Sequence[Composed]) -> Composed:
    """Return the only configuration, for commands that take just one."""
    if len(composed) > 1:
        raise ConfigError(
            f"the lists among the overrides give {len(composed)} configurations; this command "
            "takes one configuration"
        )
    return composed[0]


def _compositions(primary: str, overrides: Overrides) -> Iterator[tuple[Overrides, DictConfig]]:
    """Yield each combination of the sweeps, and its composed configuration."""
    register_defaults()
    with errors.convert_hydra_errors(), _initialized():
        for combination in overrides.combinations():
            if primary != _CHECKPOINT and combination.choice("conditions") == TRAINED:
                raise ConfigError(explain_missing_training(exported=primary == _EXPORT))
            try:
                yield combination, compose(primary, combination.words)
            except MissingConfigException as error:
                raise errors.missing_choice(error) from error
            except ConfigCompositionException as error:
                raise errors.unknown_key(error, primary, combination) from error


def _plain(composed: DictConfig) -> dict[str, Any]:
    with errors.convert_hydra_errors():
        plain = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    if not isinstance(plain, dict):
        raise ConfigError("the configuration is not a mapping")
    # Without this key, the model's defaults would replace the terms dropped by ~rewards.
    return {"rewards": {}, **{str(k): v for k, v in plain.items() if k != "hydra"}}


@contextlib.contextmanager
def _initialized() -> Iterator[None]:
    """Let Hydra compose in the body.

    Within an application of Hydra, which knows --config-dir, it does so already.
    """
    if GlobalHydra.instance().is_initialized():
        yield
        return
    with preset_folders(), initialize_config_dir(CONFIGS, version_base="1.3"):
        yield


@contextlib.contextmanager
def preset_folders() -> Iterator[None]:
    """Let Hydra look for entries of groups in the folders of plugins, too, in the body."""
    known = Plugins.instance()
    if _PresetFolders not in known.discover(SearchPathPlugin):
        known.register(_PresetFolders)
    _PresetFolders.places = presets.folders()
    try:
        yield
    finally:
        _PresetFolders.places = []


class _PresetFolders(SearchPathPlugin):
    """Adds the folders to the search path of an application of Hydra that begins."""

    places: ClassVar[list[Path]] = []
    """Empty for another application of Hydra in this process."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        for place in self.places:
            search_path.append("flipperctl-plugins", f"file://{place}")
