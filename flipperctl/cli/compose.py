"""Hydra: from overrides to validated configurations.

In: overrides as the user typed them. Out: ``TrainConfig`` and ``EvalConfig``. Plugin and section
defaults come from their classes, through Hydra's ConfigStore.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from typing import Any, TypeVar, cast

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override
from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from flipperctl import plugins
from flipperctl.api import ObservationLayout, registry
from flipperctl.cli import conditions
from flipperctl.cli.overrides import check_words, quoted, wrong_choice
from flipperctl.config import (
    DEFAULT_ENGINE,
    EnvConfig,
    EvalConfig,
    LocalCollector,
    RayCollector,
    TrainConfig,
    container,
    parse,
)
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError, RequestError
from flipperctl.messages import close_match

CONFIGS = str(files("flipperctl.configs"))
Composed = TypeVar("Composed")
_TRAINED = "_trained"  # terrain and rewards of a checkpoint, as group entries
_BY_RULE, _BY_CHECKPOINT, _BY_EXPORT = "eval", "flipperctl_eval_trained", "flipperctl_eval_exported"
"""Primary configurations of an evaluation."""
_LAUNCHER_EXTRAS = {"joblib": "joblib", "ray": "ray", "ray_aws": "ray"}
_GROUP_KEYS = (
    *("terrain", "rewards", "network", "collector"),
    *("sim", "perception", "conditions"),
)
_CHOICES = (*_GROUP_KEYS, "controller", "experiment")  # keys whose value brings other keys
_CALLED = {
    "rewards": "preset",
    "conditions": "set",
}  # what an entry of a group is called, if not as the group


def offer_defaults() -> None:
    """Put every registered plugin's and every section's defaults into the ConfigStore."""
    store = ConfigStore.instance()
    for (kind, name), cls in registry.items():
        store.store(group=kind, name=name, node=plugins.defaults(cls))
    for collector in (LocalCollector(), RayCollector()):
        store.store(group="collector", name=collector.name, node=container(collector))
    for primary, model in (("flipperctl_train", TrainConfig), ("flipperctl_eval", EvalConfig)):
        sections = {
            name: container(info.default) if hasattr(info.default, "model_dump") else info.default
            for name, info in model.model_fields.items()
            if name not in _GROUP_KEYS
        }
        store.store(name=primary, node=sections)


def offer_trained(config: TrainConfig | EvalConfig) -> str:
    """Offer an evaluation of a policy as the primary configuration; returns its name.

    The policy brings its terrain, rewards, robot and observation layout, and how often it is
    evaluated. Its other sections are ``conditions=trained``, unless it is an exported file
    (``config`` is then an ``EvalConfig``), which does not hold them.
    """
    store = ConfigStore.instance()
    own = container(config.environment())
    own["terrain"] = plugins.container(config.terrain, brief=True)
    layout = {name: own["perception"][name] for name in ObservationLayout.model_fields}
    for group in ("terrain", "rewards", "sim", "perception"):
        store.store(group=group, name=_TRAINED, node=own.pop(group))
    kept = {"robot": own.pop("robot"), "perception": layout, "eval": container(config.eval)}
    nominal = {name: container(EvalConfig(terrain=config.terrain))[name] for name in own}
    primary = _BY_EXPORT
    if isinstance(config, TrainConfig):
        primary = _BY_CHECKPOINT
        choices = [{f"override /{group}": _TRAINED} for group in ("sim", "perception")]
        node = {"defaults": choices, **own}
        store.store(group="conditions", name=conditions.TRAINED, node=node, package="_global_")
    # What is laid over others comes after them.
    defaults = [
        *({"terrain": _TRAINED}, {"rewards": _TRAINED}),
        *({group: DEFAULT_ENGINE} for group in ("sim", "perception")),
        *("_self_", {"conditions": conditions.NOMINAL}),
    ]
    store.store(name=primary, node={"defaults": defaults, **nominal, **kept})
    return primary


def validated(composed: DictConfig) -> TrainConfig:
    """The training configuration of what Hydra composed."""
    return parse(TrainConfig, _plain(composed))


def compose_train(overrides: Sequence[str]) -> list[TrainConfig]:
    """One configuration for each combination of the sweeps in ``overrides``.

    Raises:
        ConfigError: an override is malformed, unknown, of the wrong type or out of bounds.
    """
    return [parse(TrainConfig, plain) for _, plain in _compositions("train", overrides)]


def compose_eval(
    overrides: Sequence[str], primary: str = _BY_RULE
) -> list[tuple[EvalConfig, dict[str, Any] | None]]:
    """For each combination of sweeps, the configuration and the controller's settings, if any."""
    found = []
    for combination, plain in _compositions(primary, overrides):
        settings = plain.pop("controller", None)
        plain["conditions"] = conditions.chosen(combination)
        config = parse(EvalConfig, plain)
        conditions.check_effect(config, combination)
        found.append((config, settings))
    return found


def compose_environment(overrides: Sequence[str]) -> EnvConfig:
    """The environment of an evaluation with these overrides."""
    config, _ = only(compose_eval(overrides))
    return config


def only(found: Sequence[Composed]) -> Composed:
    """The one configuration, for commands that look at one.

    Raises:
        ConfigError: lists among the overrides gave several.
    """
    if len(found) > 1:
        raise ConfigError(
            f"the lists among the overrides give {len(found)} configurations; this command looks "
            "at one"
        )
    return found[0]


def _compositions(
    primary: str, overrides: Sequence[str]
) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Each combination of the sweeps, and what it composes to."""
    check_words(overrides)
    with translated(), initialize_config_dir(CONFIGS, version_base="1.3"):
        for combination in _combinations(overrides):
            if primary != _BY_CHECKPOINT and conditions.chosen(combination) == conditions.TRAINED:
                raise ConfigError(conditions.no_training(exported=primary == _BY_EXPORT))
            try:
                yield combination, _plain(compose(primary, combination))
            except MissingConfigException as error:
                raise _missing(error) from error
            except ConfigCompositionException as error:
                raise _unknown_key(error, primary, combination) from error
            except (TypeError, ValueError) as error:  # from Hydra: a group's choice is no name
                raise wrong_choice(error, combination, _GROUP_KEYS) from error


def check_mappings(overrides: Sequence[str]) -> None:
    """Refuse an empty mapping: Hydra merges it into what is there, so that nothing would change.

    Raises:
        ConfigError: with what drops what is there.
    """
    with translated():
        parsed: list[Override] = OverridesParser.create().parse_overrides(list(overrides))
    for override in parsed:
        if not override.is_delete() and override.value() == {}:
            key = override.get_key_element()
            drop = "~rewards drops every term" if key == "rewards" else f"~{key} drops it"
            raise ConfigError(
                f"{override.input_line}: a mapping is merged into what is there, and an empty one "
                f"changes nothing; {drop}"
            )


def _combinations(overrides: Sequence[str]) -> Iterator[list[str]]:
    check_mappings(overrides)
    parsed: list[Override] = OverridesParser.create().parse_overrides(list(overrides))
    choices: list[list[str]] = []
    for override in parsed:
        if override.key_or_group in _CHOICES and str(override.input_line).endswith("=null"):
            raise ConfigError(f"{override.input_line}: null is no choice here; give a name")
        if override.is_interval_sweep():
            continue  # a sweeper draws from it; the job checks what was drawn
        if override.is_sweep_override():
            key = override.get_key_element()
            choices.append([f"{key}={value}" for value in override.sweep_string_iterator()])
        else:
            choices.append([str(override.input_line)])
    for combination in itertools.product(*choices):
        yield list(combination)


def interval_probes(overrides: Sequence[str]) -> list[list[str]]:
    """For each interval among the overrides: its ends and a value between, each set on its own.

    The value between finds intervals of real numbers for settings that are whole.
    """
    with translated():
        parsed: list[Override] = OverridesParser.create().parse_overrides(list(overrides))
    found = []
    for override in parsed:
        interval = override.value()
        if isinstance(interval, IntervalSweep):
            start, end = cast("tuple[float, float]", (interval.start, interval.end))
            whole = isinstance(start, int) and isinstance(end, int)
            between = start if whole else start + 0.3819 * (end - start)
            found += [[f"{override.get_key_element()}={x}"] for x in (start, end, between)]
    return found


@contextmanager
def translated() -> Iterator[None]:
    """Turn Hydra's and OmegaConf's errors into one of ours, in one line."""
    try:
        yield
    except FlipperctlError:
        raise
    except OverrideParseException as error:
        key, _, value = str(error.override).partition("=")
        raise ConfigError(
            f"{error.override!r}: Hydra cannot read this override; if its value is meant as it "
            f"stands, quote it: {quoted(key, value)}"
        ) from error
    except MissingConfigException as error:
        raise _missing(error) from error
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(_flat(error)) from error


def _plain(composed: DictConfig) -> dict[str, Any]:
    with translated():
        plain = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    if not isinstance(plain, dict):
        raise ConfigError("the configuration is no mapping")
    # Without a key, the model's defaults would take the place of what ~rewards dropped.
    return {"rewards": {}, **{str(k): v for k, v in plain.items() if k != "hydra"}}


def _flat(error: Exception) -> str:
    return " ".join(str(error).split())


def _missing(error: MissingConfigException) -> RequestError:
    group, _, option = str(error.missing_cfg_file or "").rpartition("/")
    group, option = group.strip("/"), option.removesuffix(".yaml")
    options = [o for o in (error.options or plugins.names(group)) if not o.startswith("_")]
    if not group:
        return ConfigError(_flat(error))
    if group == "hydra/launcher" and option in _LAUNCHER_EXTRAS:
        extra = _LAUNCHER_EXTRAS[option]
        return MissingExtraError(
            f"{group}={option} needs the package hydra-{extra}-launcher; "
            f"install flipperctl[{extra}]"
        )
    what = f"{group} plugin" if plugins.names(group) else _CALLED.get(group, group)
    return ConfigError(
        f"{group}: there is no {what} {option!r}{close_match(option, options)}; "
        f"known: {', '.join(sorted(options)) or 'none'}"
    )


def _unknown_key(
    error: ConfigCompositionException, primary: str, overrides: Sequence[str]
) -> ConfigError:
    text = _flat(error)
    named = re.search(r"Could not (?:override|delete|append)[^']*'([^']+)'", text)
    if not named:
        return ConfigError(text)
    key = named[1].split("@")[0]
    choices = [o for o in overrides if o.partition("=")[0] in _CHOICES]
    node: Any = _plain(compose(primary, choices))
    *parents, leaf = key.split(".")
    inside = ""  # the innermost section on the way to the key that is there
    for parent in parents:
        if not isinstance(node.get(parent), dict):
            leaf = parent
            break
        node, inside = node[parent], f"{inside}.{parent}".lstrip(".")
    known = sorted(name for name in node if name != "name")
    cause = error.__cause__
    if isinstance(cause, OmegaConfBaseException) and "not in struct" not in str(cause):
        return ConfigError(f"{key}: {_flat(cause)}")
    return ConfigError(
        f"{key}: there is no such key{close_match(leaf, known)}; "
        f"known {'in ' + inside if inside else 'groups and keys'}: {', '.join(known)}"
    )
