"""Compose validated configurations from requests: Hydra applies the choices, ``merge`` the values.

In: requests, the registry, the models' defaults, a policy's configuration. Out: a ``TrainConfig``
or ``EvalConfig`` for each combination of the lists among the requests. Files, such as those of
``--config-dir``, are read by Hydra.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
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

from flipperctl.api import Learner, Plugin, registry
from flipperctl.config import (
    DEFAULT_ENGINE,
    EvalConfig,
    TrainConfig,
    default_engine,
    parse,
    presets,
)
from flipperctl.config.defaults import (
    CHOICES,
    LISTS,
    entries,
    missing_entry,
    refuse_ineffective,
    sections,
)
from flipperctl.config.merge import change, drop
from flipperctl.config.sampled import SECTIONS as SAMPLED
from flipperctl.config.words import escaped
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import NOMINAL, TRAINED, Inherited, explain_missing_training
from flipperctl.plugging import plugins
from flipperctl.requests import errors
from flipperctl.requests.request import RUN_FOLDER, Request, Requests
from flipperctl.terminal.streams import print_note, print_notices

CONFIGS = str(resources.files("flipperctl.configs"))
TRAINING = "train"
"""Primary configuration of a training."""
EVAL_CONTROLLER = "eval"
"""Primary configuration of an evaluation of a controller."""
_CHECKPOINT, _EXPORT = "flipperctl_eval_trained", "flipperctl_eval_exported"
"""Primary configurations of an evaluation of a checkpoint, and of an exported file."""
_TRAINED = "_trained"  # terrain, robot and rewards of a policy, as group entries
_registered: dict[tuple[str, str], type[Plugin]] = {}
_of_choices: dict[tuple[str, tuple[str, ...]], DictConfig] = {}
"""Hydra's compositions by primary configuration and choices, until an entry changes."""
_stored: dict[tuple[str, str], dict[str, Any]] = {}
"""The entries in the ConfigStore by group and name."""
Composed = TypeVar("Composed")


def register_defaults() -> None:
    """Store the defaults of every registered plugin and every section in the ConfigStore.

    Do nothing if no plugin has been registered since the last call.
    """
    if _registered == registry:
        return
    store = ConfigStore.instance()
    for group, name, node in entries():
        if _stored.get((group, name)) == node:
            continue
        _stored[group, name] = deepcopy(node)
        _of_choices.clear()
        # Several entries of a list may be chosen; an entry without settings adds nothing.
        package = f"{group}.{name}" if group in LISTS and node else None
        if group == Learner.kind:
            # A learner may choose its network, and may have mappings that take new keys.
            fields = node.get(group, node)
            if fields is not node:  # it chooses its network, too
                package = "_global_"
            for key, info in registry[group, name].model_fields.items():
                if get_origin(info.annotation) is dict:  # it takes new keys without a +
                    default = info.get_default(call_default_factory=True)
                    fields[key] = OmegaConf.create(default, flags={"struct": False})
        store.store(group=group, name=name, node=node, package=package)

    # What no group chooses, and no plugin changes
    if not _registered:
        store.store(name="flipperctl_train", node=_with_paths(sections(TrainConfig)))
        store.store(name="flipperctl_eval", node=_with_paths(sections(EvalConfig)))
    _registered.clear()
    _registered.update(registry)


def _with_paths(sections: dict[str, Any]) -> dict[str, Any]:
    """Return the sections, with the mappings of ``randomise`` open for new keys without a +."""
    randomise = sections["randomise"]
    open_for_keys = {
        section: OmegaConf.create(randomise[section], flags={"struct": False})
        for section in SAMPLED
    }
    return {**sections, "randomise": {**randomise, **open_for_keys}}


def register_trained(config: TrainConfig | EvalConfig) -> str:
    """Register the evaluation of a policy as a primary configuration; return its name.

    The sections of its training become ``conditions=trained``, unless the file lacks them.
    """
    store = ConfigStore.instance()
    inherited = Inherited.of(config)
    for group, node in inherited.chosen.items():
        store.store(group=group, name=_TRAINED, node=node)

    # A checkpoint's own engine, sensor and other sections become conditions.
    primary, groups = _EXPORT, ("sim", "perception")
    if inherited.trained is not None:
        primary, trained = _CHECKPOINT, dict(inherited.trained)
        for group in groups:
            store.store(group=group, name=_TRAINED, node=trained.pop(group))
        choices = [{f"override /{group}": _TRAINED} for group in groups]
        node = {"defaults": choices, **_with_paths(trained)}
        store.store(group="conditions", name=TRAINED, node=node, package="_global_")
    # Later entries override earlier ones.
    defaults = [
        *({group: _TRAINED} for group in inherited.chosen),
        {"sim": default_engine(config.robot.flippers)},
        {"perception": DEFAULT_ENGINE},
        "_self_",
        {"conditions": NOMINAL},
    ]
    nominal = _with_paths(inherited.nominal)
    store.store(name=primary, node={"defaults": defaults, **nominal, **inherited.kept})
    return primary


def compose_train(requests: Requests = Requests()) -> list[TrainConfig]:  # noqa: B008  # frozen
    """Return one configuration for each combination of the lists in ``requests``.

    Raises:
        ConfigError: a request is unknown, of the wrong type, out of bounds or without effect.
    """
    configs = []
    for combination, composed in _compositions(TRAINING, requests):
        config = parse_training(composed)
        check_training_effect(config, combination)
        print_notices(config)
        configs.append(config)
    return configs


def parse_training(composed: DictConfig) -> TrainConfig:
    """Validate a composed training configuration."""
    plain = _plain(composed)
    teacher, agent = plain.get("teacher"), plain.get("agent")
    if isinstance(teacher, dict) and isinstance(agent, dict) and "controller" in teacher:
        # A preset of a teacher's rewards depends on the discount that shaping has.
        gamma = Request("agent.gamma", agent.get("gamma"))
        settings = with_preset(teacher["controller"], "teacher.controller", "train", gamma)
        plain = {**plain, "teacher": {**teacher, "controller": settings}}
    return parse(TrainConfig, {"logger": {}, **plain})


def check_training_effect(config: TrainConfig, requests: Requests) -> None:
    """Refuse a change of a setting that a training samples anew for every episode.

    Settings of the robot have an effect: policies and evaluations assume the configured one.
    """
    typed = requests.typed.items()
    refuse_ineffective(config, {key: word for key, word in typed if not key.startswith("robot.")})


def run_directory(requests: Requests) -> Path:
    """Return the directory of a single run, ``hydra.run.dir``, for requests that compose."""
    with errors.convert_hydra_errors(), _initialized():
        return Path(OmegaConf.select(_merged(TRAINING, requests, hydra=True), RUN_FOLDER))


def compose_eval(
    requests: Requests, primary: str = EVAL_CONTROLLER
) -> list[tuple[EvalConfig, dict[str, Any] | None]]:
    """Return the configuration of each combination, and the controller's settings, if any."""
    scenes = []
    for combination, composed in _compositions(primary, requests):
        plain = _plain(composed)
        settings = with_preset(plain.pop("controller", None), "controller")
        plain["conditions"] = combination.choice("conditions") or NOMINAL
        config = parse(EvalConfig, plain)
        refuse_ineffective(config, combination.typed)
        print_notices(config)
        scenes.append((config, settings))
    return scenes


def compose_environment(requests: Requests, primary: str = EVAL_CONTROLLER) -> EvalConfig:
    """Return the only configuration of an evaluation, which is an environment's, too."""
    config, _ = only_one(compose_eval(requests, primary))
    return config


def with_preset(
    controller: Any, path: str, primary: str = EVAL_CONTROLLER, *requests: Request
) -> Any:
    """Return a controller's settings, with the terms of the preset if ``rewards`` is its name.

    ``path``: section of the controller. ``requests``: what the preset depends on.
    """
    name = controller.get("rewards") if isinstance(controller, dict) else None
    if not isinstance(name, str):
        return controller
    known = group_names("rewards")
    if name not in known:
        raise missing_entry("rewards", name, known, f"{path}.rewards")
    with _initialized():
        composed = _plain(_merged(primary, Requests((Request("rewards", name), *requests))))
    return {**controller, "rewards": composed["rewards"]}


def group_names(group: str) -> list[str]:
    """Return the names of a group's entries, also of plugins."""
    register_defaults()
    with _initialized():
        return [name for name in _options(group) if not name.startswith("_")]


def _options(group: str) -> list[str]:
    return GlobalHydra.instance().config_loader().get_group_options(group)


def only_one(composed: Sequence[Composed]) -> Composed:
    """Return the only configuration, for commands that take just one."""
    if len(composed) > 1:
        raise ConfigError(
            f"the lists among the overrides give {len(composed)} configurations; this command "
            "takes one configuration"
        )
    return composed[0]


def _compositions(primary: str, requests: Requests) -> Iterator[tuple[Requests, DictConfig]]:
    """Yield each combination of the lists, and its composed configuration."""
    register_defaults()
    with errors.convert_hydra_errors(), _initialized():
        for combination in requests.combinations():
            if primary != _CHECKPOINT and combination.choice("conditions") == TRAINED:
                raise ConfigError(explain_missing_training(exported=primary == _EXPORT))
            yield combination, _merged(primary, combination)


def _merged(primary: str, requests: Requests, *, hydra: bool = False) -> DictConfig:
    """Return a configuration whose texts may still refer to its settings, as in ``${seed}``.

    ``hydra``: whether it has the settings of Hydra, too.
    """
    # Hydra applies the choices of entries; all values are merged afterwards.
    choices: list[Request] = []
    values: list[Request] = []
    for request in requests.expanded:
        (choices if _is_choice(request) else values).append(request)
    try:
        composed = _composed(primary, tuple(r.text for r in choices), hydra=hydra)
    except MissingConfigException as error:
        raise errors.missing_choice(error) from error
    except ConfigCompositionException as error:
        raise errors.wrong_choice(error, choices, _composed(primary, (), hydra=hydra)) from error
    plain: Any = OmegaConf.to_container(composed)
    for chosen, keys in _of_others(primary, choices, plain):
        for key in keys:
            drop(plain, key)
        if not hydra:  # the folder of a run is asked for by itself
            print_note(f"the experiment sets what {chosen} has not, left out: {', '.join(keys)}")

    # In their order, so that a later request may lie within an earlier one
    for request in values:
        errors.check_key(request, composed, plain)
        if request.drops:
            drop(plain, request.key)
        else:
            change(plain, request.key, request.value if request.typed else escaped(request.value))
    merged: DictConfig = OmegaConf.create(plain)
    return merged


def _of_others(
    primary: str, choices: Sequence[Request], plain: Mapping[str, Any]
) -> Iterator[tuple[str, list[str]]]:
    """Yield what is chosen in place of an experiment's plugin, and the keys that it lacks."""
    if not any(request.key == "experiment" for request in choices):
        return
    for request in choices:
        group, name = request.key, request.value
        plugin = registry.get((group, str(name)))
        if plugin is None or group in LISTS:  # several of a list stand beside each other
            continue
        if unknown := {*plain[group]} - {"name", *plugin.model_fields}:
            others = tuple(other.text for other in choices if other is not request)
            before = registry[group, _composed(primary, others, hydra=False)[group]["name"]]
            yield f"{group}={name}", [f"{group}.{k}" for k in before.model_fields if k in unknown]


def _composed(primary: str, choices: tuple[str, ...], *, hydra: bool) -> DictConfig:
    """Return Hydra's composition, to be read alone: equal choices of installed entries give one."""
    fixed = primary in (TRAINING, EVAL_CONTROLLER) and not hydra
    if not fixed or any(text.startswith("hydra") for text in choices) or not _installed_alone():
        return compose(primary, [*choices], return_hydra_config=hydra)
    if (primary, choices) not in _of_choices:
        _of_choices[primary, choices] = compose(primary, [*choices])
    return _of_choices[primary, choices]


def _installed_alone() -> bool:
    """Return whether no entry is a file of the user, which may change between two compositions."""
    search = GlobalHydra.instance().config_loader().get_search_path().get_path()
    places = {place.path.removeprefix("file://") for place in search}
    folders = {CONFIGS, *map(str, plugins.folders())}
    others = [place for place in places - folders if not place.startswith(("pkg:", "structured:"))]
    return not (others or plugins.configured_paths())


def _is_choice(request: Request) -> bool:
    """Return whether Hydra applies the request: the choice of an entry, or one of its settings."""
    key = request.key
    if request.package is not None or key.startswith("hydra"):
        return True
    if isinstance(request.value, dict) or "." in key:
        return False
    # Hydra takes long to list what may be a group of the user's own files.
    return key in CHOICES or (key not in TrainConfig.model_fields and bool(_options(key)))


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
