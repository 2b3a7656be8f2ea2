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

from flipperctl.api import Learner
from flipperctl.api.plugin import registered_names
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig
from flipperctl.config.defaults import CHOICES, missing_entry
from flipperctl.config.words import unreadable
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError, RequestError
from flipperctl.text.messages import explain_unknown_key

_MISSING = "<missing>"
_FORMER_LEARNERS = ("method", "agent.learner", "agent.policy_gradient")
"""Keys by which learners were chosen before they were plugins."""
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
            return package in ("hydra", "omegaconf", "antlr4", "yaml")
    return False


def missing_choice(error: MissingConfigException) -> RequestError:
    """Return the error for a config group that has no such entry, as in ``terrain=stiar``."""
    group, _, option = str(error.missing_cfg_file or "").rpartition("/")
    group, option = group.strip("/"), option.removesuffix(".yaml")
    choice, _, rest = group.partition("/")
    if rest and choice in CHOICES:  # a path is no name of a group: it belongs to the option
        group, option = choice, f"{rest}/{option}"
    options = [o for o in (error.options or registered_names(group)) if not o.startswith("_")]
    if not group:
        return ConfigError(_one_line(error))
    if group == "hydra/launcher" and option in _LAUNCHERS:
        package = f"hydra-{_LAUNCHERS[option]}-launcher"
        return MissingExtraError(f"{group}={option} needs {package}: pip install {package}")
    missing = missing_entry(group, option, options)
    if group == "robot":
        return ConfigError(f"{missing}; a file of your own ends in .yaml")
    return ConfigError(f"{missing}; {_OWN_CONDITIONS}") if group == "conditions" else missing


def unknown_key(
    error: ConfigCompositionException, primary: str, overrides: Overrides
) -> ConfigError:
    """Return the error for an override of an unknown key, or ``error`` in one line."""
    groups = [o for o in overrides.parsed if _is_group(o)]
    known: Any = OmegaConf.to_container(compose(primary))
    plain = [o for o in groups if o.package is None and o.key_or_group in known]
    plain = [o for o in plain if not (o.is_add() or o.is_delete())]
    # Groups are applied before keys; entries are added to what the choices among them brought.
    for chosen, words in ((plain, groups), (groups, overrides.parsed)):
        try:
            composed = compose(primary, [str(o.input_line) for o in chosen])
        except ConfigCompositionException as refusal:
            return ConfigError(_one_line(refusal))
        node: Any = OmegaConf.to_container(composed, resolve=True)
        for override in words:
            if override not in chosen and (text := _fault(override, node)):
                return ConfigError(text)
    cause = error.__cause__
    if isinstance(cause, ConfigAttributeError | ConfigKeyError) and cause.full_key:
        return ConfigError(explain_unknown_key(str(cause.full_key), node))
    return ConfigError(_one_line(error))


def _fault(override: Override, node: Mapping[str, Any]) -> str:
    """Return why the key of an override does not fit the composed ``node``; empty if it does."""
    key, section = override.package or override.key_or_group, override.key_or_group.split(".")[0]
    if section.startswith("hydra") or override.is_force_add():
        return ""
    exists = OmegaConf.select(OmegaConf.create(dict(node)), key, default=_MISSING) != _MISSING
    if override.is_add() and exists:
        return f"{key} exists already; write {str(override.input_line).removeprefix('+')}"
    if override.is_add() or exists:
        return ""
    if key.startswith(_FORMER_LEARNERS) and "network" in node:
        names = ", ".join(registered_names(Learner.kind))
        return (
            f"{key}: a learner is chosen by its name, agent=NAME ({names}), and its settings "
            "follow as agent.SETTING"
        )
    if section not in node and section in TrainConfig.model_fields.keys() - {"seed"}:
        return f"{key}: it belongs to a training, and has no meaning here"
    return explain_unknown_key(key, node)


def _is_group(override: Override) -> bool:
    """Return whether Hydra treats the override as the choice of a config group."""
    options = GlobalHydra.instance().config_loader().get_group_options(override.key_or_group)
    return bool(options) and not isinstance(override.value(), dict)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
