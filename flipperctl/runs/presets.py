"""Compose a configuration from presets by name, and changes by key, without the command line.

In: choices such as ``{"experiment": "generalist", "conditions": "wide"}``, and changes such as
``{"train.decisions": 4000}``. Out: the configuration that the same overrides give a command.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from importlib.resources import files
from typing import Any, TypeVar

from omegaconf import OmegaConf

from flipperctl.config import DEFAULT_ENGINE, EvalConfig, TrainConfig, parse, with_overrides
from flipperctl.config.defaults import entries, missing_entry, sections
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match
from flipperctl.runs.inherited import NOMINAL, TRAINED, Inherited, explain_missing_training

Whole = TypeVar("Whole", TrainConfig, EvalConfig)
_SELF = "_self_"
_NOTHING: dict[str, Any] = {}
_WHOLE = ("conditions", "experiment")
"""Groups whose presets change the whole configuration, not one section."""


def train_config(
    choices: Mapping[str, str] | None = None, changes: Mapping[str, Any] | None = None
) -> TrainConfig:
    """Return the configuration of a training.

    Raises:
        ConfigError: there is no such group, preset or plugin, or a setting is wrong.
    """
    return _compose(TrainConfig, "train", choices or {}, changes or {})


def eval_config(
    choices: Mapping[str, str] | None = None, changes: Mapping[str, Any] | None = None
) -> EvalConfig:
    """Return the configuration of an evaluation of a controller; see ``train_config``."""
    return _compose(EvalConfig, "eval", choices or {}, changes or {})


def policy_config(
    trained: TrainConfig | EvalConfig,
    choices: Mapping[str, str] | None = None,
    changes: Mapping[str, Any] | None = None,
) -> EvalConfig:
    """Return the configuration of an evaluation of a policy's file; see ``train_config``.

    ``trained`` is that of a checkpoint, or what an exported file holds of it
    (``runs.inherited.read_config``). Its terrain and rewards stay unless ``choices`` name others;
    the conditions are nominal unless ``choices`` name others, such as ``trained``.

    Raises:
        ConfigError: there is no such group, preset or plugin, or a setting is wrong.
    """
    inherited, choices = Inherited.of(trained), dict(choices or {})
    conditions = choices.pop("conditions", NOMINAL)
    groups = {"sim": DEFAULT_ENGINE, "perception": DEFAULT_ENGINE}
    known = ("terrain", "rewards", *groups)
    _check_groups(choices, (*known, "conditions"))
    own, last = dict(inherited.chosen), _NOTHING
    if conditions == TRAINED:
        if inherited.trained is None:
            raise ConfigError(explain_missing_training(exported=True))
        rest = dict(inherited.trained)
        own |= {group: rest.pop(group) for group in groups}
        last, groups = rest, {}
    made = _made()
    own |= {group: _entry(group, name, made) for group, name in (groups | choices).items()}
    if conditions != TRAINED:
        last = _entry("conditions", conditions, made)
    parts = [own, inherited.nominal, inherited.kept, last, {"conditions": conditions}]
    return _built(EvalConfig, parts, changes or {})


def _compose(
    model: type[Whole], primary: str, choices: Mapping[str, str], changes: Mapping[str, Any]
) -> Whole:
    default, _ = _read(f"{primary}.yaml")
    known = {group: name for group, name in default.items() if "/" not in group and group != name}
    _check_groups(choices, known)
    preset = choices.get("experiment")
    chosen, last = _experiment(preset) if preset else ({}, {})
    chosen = {**known, **chosen, **choices}
    chosen.pop("controller", None)  # no part of the configuration
    parts: list[Any] = [sections(model)]
    made = _made()
    for group, name in chosen.items():
        if group not in _WHOLE:
            parts.append({group: _entry(group, name, made)})
    parts += [_entry("conditions", chosen["conditions"], made), last]
    if model is EvalConfig:
        parts.append({"conditions": chosen["conditions"]})
    return _built(model, parts, changes)


def _built(model: type[Whole], parts: Sequence[Any], changes: Mapping[str, Any]) -> Whole:
    """Return the configuration that the parts make, of which later ones override earlier ones."""
    merged = OmegaConf.merge(*map(OmegaConf.create, parts))
    plain: Any = OmegaConf.to_container(merged, resolve=True)
    return with_overrides(parse(model, plain), dict(changes))


def _check_groups(choices: Collection[str], known: Collection[str]) -> None:
    for group in choices:
        if group not in known:
            raise ConfigError(
                f"{group}: there is no such group{close_match(group, known)}; "
                f"known: {', '.join(sorted(known))}"
            )


def _made() -> dict[tuple[str, str], Any]:
    """Return the entry of each plugin and variant, by group and name."""
    return {(group, name): node for group, name, node in entries()}


def _experiment(name: str) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the choices of an experiment and of those that it extends, and its settings."""
    defaults, own = _preset("experiment", name)
    choices: dict[str, str] = {}
    settings: Any = OmegaConf.create()
    for key, value in defaults.items():
        if value == _SELF:
            continue
        if key.startswith("override /"):
            choices[key.removeprefix("override /")] = value
        else:
            inherited, more = _experiment(value)
            choices, settings = {**choices, **inherited}, OmegaConf.merge(settings, more)
    found: Any = OmegaConf.merge(settings, own)
    return choices, found


def _entry(group: str, name: str, made: Mapping[tuple[str, str], Any]) -> Any:
    """Return the settings of an entry: one that is ``made`` of a plugin's, or a preset."""
    if (group, name) in made:
        return OmegaConf.create(made[group, name])
    defaults, own = _preset(group, name, [other for kind, other in made if kind == group])
    parts: list[Any] = []
    for key, value in defaults.items():
        if value == _SELF:
            parts.append(own)
        elif "@" in key:  # /reward@flipper: flipper
            kind, _, place = key.removeprefix("/").partition("@")
            parts.append({place: _entry(kind, value, made)})
        else:
            parts.append(_entry(group, value, made))
    return OmegaConf.merge(*map(OmegaConf.create, [*parts, own]))


def _preset(group: str, name: str, others: Collection[str] = ()) -> tuple[dict[str, str], Any]:
    """Read a preset; ``others`` are further names of the group, for the error."""
    folder = files("flipperctl.configs") / group
    found = [f.name for f in folder.iterdir()] if folder.is_dir() else []
    known = sorted({*others, *(f.removesuffix(".yaml") for f in found if f.endswith(".yaml"))})
    if name not in known:
        raise missing_entry(group, name, known)
    return _read(f"{group}/{name}.yaml")


def _read(path: str) -> tuple[dict[str, str], Any]:
    """Return the defaults list of a file of ``configs/`` as a mapping, and its other contents."""
    text = files("flipperctl.configs").joinpath(path).read_text(encoding="utf-8")
    found: Any = OmegaConf.create(text)
    defaults: dict[str, str] = {}
    for item in found.pop("defaults", []):
        pairs = [(item, item)] if isinstance(item, str) else list(item.items())
        defaults |= {str(key): value for key, value in pairs}
    found.pop("hydra", None)
    return defaults, found
