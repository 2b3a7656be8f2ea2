"""The configuration that Hydra composes: defaults of plugins and sections, and files.

In: the registry, the models' defaults, a checkpoint's configuration. Out: entries of config groups,
and primary configurations. Files, such as those of ``--config-dir``, are read by our strict reader
as long as a command composes; what another application of Hydra in this process reads stays
Hydra's.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib import resources
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from hydra._internal.core_plugins.file_config_source import FileConfigSource
from hydra._internal.core_plugins.importlib_resources_config_source import (
    ImportlibResourcesConfigSource,
)
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import OmegaConf

from flipperctl.api import ObservationLayout, Plugin, Robot, registry
from flipperctl.config import DEFAULT_ENGINE, EvalConfig, TrainConfig, strict_yaml, to_dict
from flipperctl.config.defaults import LISTS, entries, sections
from flipperctl.config.randomise import OMITTED, PATH_SECTIONS
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import NOMINAL, TRAINED, Inherited
from flipperctl.training.search_space import SearchSettings

CONFIGS = str(files("flipperctl.configs"))
EVAL_CONTROLLER = "eval"
EVAL_CHECKPOINT, EVAL_EXPORT = "flipperctl_eval_trained", "flipperctl_eval_exported"
"""Primary configurations of an evaluation of a controller, a checkpoint and an exported file."""
EVAL_ROBOT = "flipperctl_eval_robot"
"""Primary configuration of an evaluation of a controller with a robot that a file describes."""
_TRAINED = "_trained"  # terrain, robot and rewards of a policy, as group entries
_registered: dict[tuple[str, str], type[Plugin]] = {}
_SWEEPERS = "hydra_plugins.flipperctl_sweepers"


class _SharedStore(ConfigStore):
    """Hydra's store of configurations, which copies of Hydra's repository share.

    Hydra copies its repository for each composition, and with it every entry of the store, which
    takes two fifths of a composition's time. It copies an entry again when it loads it.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> _SharedStore:
        return self


def register_defaults() -> None:
    """Store the defaults of every registered plugin and every section in the ConfigStore.

    Do nothing if no plugin has been registered since the last call.
    """
    if _registered == registry:
        return
    store = ConfigStore.instance()
    if type(store) is ConfigStore:
        store.__class__ = _SharedStore
    for group, name, node in entries():
        # Several entries of a list may be chosen; an entry without settings adds nothing.
        package = f"{group}.{name}" if group in LISTS and node else None
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
    primary = EVAL_EXPORT
    if found.trained is not None:
        primary = EVAL_CHECKPOINT
        sections = dict(found.trained)
        for group in ("sim", "perception"):
            store.store(group=group, name=_TRAINED, node=sections.pop(group))
        choices = [{f"override /{group}": _TRAINED} for group in ("sim", "perception")]
        node = {"defaults": choices, **_with_paths(sections)}
        store.store(group="conditions", name=TRAINED, node=node, package="_global_")
    # Later entries override earlier ones.
    defaults = [
        *({group: _TRAINED} for group in found.chosen),
        *({group: DEFAULT_ENGINE} for group in ("sim", "perception")),
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
    store.store(name=EVAL_ROBOT, node=node)
    return EVAL_ROBOT


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


_HEADER = 512
"""Length of the text in which Hydra looks for ``# @package`` [characters]."""


@contextlib.contextmanager
def strict_files() -> Iterator[None]:
    """Let Hydra read the files of its configuration with ours while the body composes."""
    resolve = SourcesRegistry.resolve

    def resolve_strictly(self: SourcesRegistry, scheme: str) -> type[ConfigSource]:
        ours = {source.scheme(): source for source in (_Files, _Packages)}
        return ours.get(scheme) or resolve(self, scheme)

    # Not registered in their place, since launchers hand the registry to their processes.
    SourcesRegistry.resolve = resolve_strictly  # type: ignore[method-assign]  # for a while
    try:
        yield
    finally:
        SourcesRegistry.resolve = resolve  # type: ignore[method-assign]  # Hydra's own


class _Files(FileConfigSource):
    def load_config(self, config_path: str) -> ConfigResult:
        return _read(self, Path(self.path), config_path)


class _Packages(ImportlibResourcesConfigSource):
    def load_config(self, config_path: str) -> ConfigResult:
        return _read(self, resources.files(self.path), config_path)


def _read(source: ConfigSource, folder: Traversable, name: str) -> ConfigResult:
    file = folder.joinpath(source._normalize_file_name(name))
    if not file.is_file():
        raise ConfigLoadError(f"Config not found : {file}")
    text = strict_yaml.read_text(file, str(file))
    found = strict_yaml.parse(text, str(file))
    if not isinstance(found, dict | None):
        raise ConfigError(f"{file}: a mapping is allowed; it holds {found!r:.60}")
    try:
        header = source._get_header_dict(text[:_HEADER])
    except ValueError as error:
        raise ConfigError(f"{file}: {error}") from error
    return ConfigResult(source.provider, source.full_path(), OmegaConf.create(found or {}), header)
