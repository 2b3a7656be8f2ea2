"""Explain Hydra's errors: the wrong key or choice, the known ones, and a close match.

In: an exception of Hydra or OmegaConf. Out: one of the package's own, in one line. The text
of an exception is never parsed; the wrong override is the first that Hydra refuses.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override
from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from flipperctl.api import Logger, RewardTerm
from flipperctl.api.plugin import registered_names
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig
from flipperctl.config.defaults import CHOICES, missing_entry
from flipperctl.config.words import unreadable
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError, RequestError
from flipperctl.messages import explain_unknown_key

_HOLDERS = {"rewards": RewardTerm.kind, Logger.kind: Logger.kind}
"""Sections whose keys are plugins that were added by name, and the group of these plugins."""
_OWN_CONDITIONS = (
    "conditions of your own are overrides, as in sim.friction=0.6, which a suite file can hold "
    "(suite=FILE.yaml)"
)
_LAUNCHERS = {
    **{"joblib": "joblib", "ray": "ray", "ray_aws": "ray", "rq": "rq"},
    **{"submitit_local": "submitit", "submitit_slurm": "submitit"},
}
"""Launchers of Hydra that are packages of their own, hydra-NAME-launcher, by their options."""


@contextmanager
def convert_hydra_errors() -> Iterator[None]:
    """Convert errors of Hydra and OmegaConf to the package's own, in one line.

    On values that they do not expect, such as ``hydra.verbose=1``, they raise Python's own, too.
    """
    try:
        yield
    except OverrideParseException as error:
        raise unreadable(str(error.override)) from error
    except MissingConfigException as error:
        raise missing_choice(error) from error
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(_one_line(error)) from error
    except (FlipperctlError, OSError):
        raise
    except Exception as error:  # any, since Hydra does not convert those of the values
        if not _is_of_hydra(error):
            raise
        text = _one_line(error) or type(error).__name__
        raise ConfigError(f"Hydra cannot use the words or its settings: {text}") from error


def _is_of_hydra(error: Exception) -> bool:
    """Return whether Hydra or OmegaConf raised the error, or called the library that did."""
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        package = str(frame.f_globals.get("__name__")).partition(".")[0]
        if package not in sys.stdlib_module_names:
            return package in ("hydra", "omegaconf", "antlr4")
    return False


def missing_choice(error: MissingConfigException) -> RequestError:
    """Return the error for a config group that has no such entry, as in ``terrain=stiar``."""
    group, _, option = str(error.missing_cfg_file or "").rpartition("/")
    group, option = group.strip("/"), option.removesuffix(".yaml")
    options = [o for o in (error.options or registered_names(group)) if not o.startswith("_")]
    if not group:
        return ConfigError(_one_line(error))
    if group == "hydra/launcher" and option in _LAUNCHERS:
        package = f"hydra-{_LAUNCHERS[option]}-launcher"
        return MissingExtraError(f"{group}={option} needs {package}: pip install {package}")
    missing = missing_entry(group, option, options)
    return ConfigError(f"{missing}; {_OWN_CONDITIONS}") if group == "conditions" else missing


def unknown_key(
    error: ConfigCompositionException, primary: str, overrides: Overrides
) -> ConfigError:
    """Return the error for an override of an unknown key, or ``error`` in one line."""
    choices = [word for word in overrides.words if word.partition("=")[0] in CHOICES]
    if _refusal(primary, choices):  # a choice itself is wrong, as controller=… of a training
        choices = []
    # The first word that Hydra refuses; it applies overrides of groups before those of keys.
    others = [o for o in overrides.parsed if str(o.input_line) not in choices]
    accepted = list(choices)
    for override in sorted(others, key=lambda o: not _is_group(o)):
        accepted.append(str(override.input_line))
        if wrong := _refusal(primary, accepted):
            break
        if _is_group(override):
            choices.append(accepted[-1])
    else:
        return ConfigError(_one_line(error))
    key, cause, group = override.key_or_group, wrong.__cause__, _is_group(override)
    replacement = str(override.input_line).removeprefix("+")
    if override.is_add() and group and not _refusal(primary, [*choices, replacement]):
        return ConfigError(
            f"{override.package or key} exists already; to replace it, write {replacement}"
        )
    if not _names_no_key(override, wrong):
        return ConfigError(_one_line(error))
    node: Any = OmegaConf.to_container(compose(primary, choices), resolve=True)
    if override.is_delete() and group and override.value() and not override.package:
        key = f"{key}={override.value()}"
    if isinstance(cause, OmegaConfBaseException) and cause.object_type is not dict:
        return ConfigError(f"{key}: {_one_line(cause)}")  # in Hydra's own section
    addition = None if override.is_delete() else _addition(override, node)
    if addition and group:
        key = addition.partition("@")[2].partition("=")[0]
    if override.is_add() and OmegaConf.select(OmegaConf.create(node), key) is not None:
        return ConfigError(f"{key} exists already; write it without +")
    section = key.partition(".")[0]
    if section == "method" and "network" in node and section not in node:
        return ConfigError(f"{key}: the method of a training is chosen first; add method=sb3")
    if section not in node and section in TrainConfig.model_fields.keys() - {"seed"}:
        return ConfigError(f"{key}: it belongs to a training, and has no meaning here")
    hint = f"; to add it, write {addition}" if addition else ""
    return ConfigError(explain_unknown_key(key, node) + hint)


def _refusal(primary: str, words: list[str]) -> ConfigCompositionException | None:
    """Return Hydra's exception for these words, None if they compose."""
    try:
        compose(primary, words)
    except ConfigCompositionException as error:
        return error
    return None


def _addition(override: Override, node: Mapping[str, Any]) -> str | None:
    """Return the word that adds the plugin which an override of ``rewards`` or ``logger`` names.

    These are ``reward@rewards.mine=calm`` and ``reward=calm`` without their +, and keys of a term
    that is not in ``node``: ``rewards.mine=calm`` and ``rewards.calm.weight=2``.
    """
    section, _, rest = (override.package or override.key_or_group).partition(".")
    part, value = rest.partition(".")[0], override.value()
    for holder, group in _HOLDERS.items():
        known = registered_names(group)
        if override.key_or_group == group and value in known:
            return f"+{group}@{holder}.{part or value}={value}"
        if section == holder and part and part not in node.get(holder, {}):
            name = value if rest == part and value in known else part
            return f"+{group}@{holder}.{part}={name}" if name in known else None
    return None


def _names_no_key(override: Override, error: ConfigCompositionException) -> bool:
    """Return whether ``error`` is about the override's key, rather than about its value."""
    added = override.is_add() or override.is_force_add()
    if override.key_or_group and _is_group(override):
        return not added
    if not override.key_or_group or override.package is not None:
        return False
    if error.__cause__ is None:  # the key to delete is missing, or the key to add exists
        return True
    no_such_key = isinstance(error.__cause__, ConfigAttributeError | ConfigKeyError)
    return no_such_key and not added and not override.is_delete()


def _is_group(override: Override) -> bool:
    """Return whether Hydra treats the override as the choice of a config group."""
    options = GlobalHydra.instance().config_loader().get_group_options(override.key_or_group)
    return bool(options) and not isinstance(override.value(), dict)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
