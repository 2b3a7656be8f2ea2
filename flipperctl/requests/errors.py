"""Explain wrong keys and choices: the known ones, and a close match.

In: an exception of Hydra or OmegaConf, or a request. Out: one of the package's own exceptions, in
one line. The text of an exception is never parsed.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from hydra.errors import (
    ConfigCompositionException,
    HydraException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from flipperctl.api import Learner
from flipperctl.api.plugin import registered_names
from flipperctl.config import TrainConfig
from flipperctl.config.defaults import CHOICES, missing_entry
from flipperctl.config.merge import MISSING, find
from flipperctl.config.words import unreadable
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError, RequestError
from flipperctl.requests.request import Request
from flipperctl.text.messages import explain_unknown_key

_FORMER_LEARNERS = ("method", "agent.learner", "agent.policy_gradient")
"""Keys by which learners were chosen before they were plugins."""
_OWN_CONDITIONS = (
    "conditions of your own are overrides, as in sim.friction=0.6, which a suite file can hold "
    "(suite=FILE.yaml)"
)
_LAUNCHERS = {
    "joblib": "joblib",
    "ray": "ray",
    "ray_aws": "ray",
    "rq": "rq",
    "submitit_local": "submitit",
    "submitit_slurm": "submitit",
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
    # A name with slashes was taken for a group within the group.
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


def wrong_choice(
    error: ConfigCompositionException, choices: Iterable[Request], composed: DictConfig
) -> ConfigError:
    """Return the error for a choice that does not fit the configuration, ``composed`` without it.

    A group must be there, unless the choice adds it.
    """
    node: Any = OmegaConf.to_container(composed)
    for request in choices:
        key = request.package or request.key
        present = find(node, key) is not MISSING
        if present and request.prefix == "+":
            return ConfigError(f"{key} exists already; write {request.text.removeprefix('+')}")
        if not (present or request.prefix or key.startswith("hydra")):
            return ConfigError(_unknown(key, node))
    return ConfigError(_one_line(error))


def check_key(request: Request, composed: DictConfig, plain: Mapping[str, Any]) -> None:
    """Refuse a change of a key that does not exist, and an addition of one that does.

    ``composed``: what Hydra composed, which knows which sections are open for new keys. ``plain``:
    the same as plain data, with the changes so far.
    """
    # ++ is always allowed; + must add, and without a prefix nothing new may come.
    old = find(plain, request.key)
    if request.prefix == "++":
        return
    if request.prefix == "+":
        if old not in (MISSING, None) and not isinstance(request.value, dict | list):
            text = request.text.removeprefix("+")
            raise ConfigError(f"{request.key} exists already; write {text}")
        return
    if request.drops and request.value not in (None, old):
        raise ConfigError(f"{request.text}: the value of {request.key} is {old!r}")
    for key in _new_keys(request.key, request.value, old):
        if not _is_open(composed, key):
            raise ConfigError(_unknown(key, plain))


def _new_keys(key: str, value: Any, old: Any) -> Iterator[str]:
    """Yield the keys of a value that the old one does not have."""
    if old is MISSING:
        yield key
    elif isinstance(value, dict) and isinstance(old, dict):
        for name, inner in value.items():
            yield from _new_keys(f"{key}.{name}", inner, old.get(name, MISSING))


def _is_open(composed: DictConfig, key: str) -> bool:
    """Return whether a section on the path to a key takes new keys."""
    parts = key.split(".")[:-1]
    paths = [".".join(parts[: end + 1]) for end in range(len(parts))]
    nodes = [OmegaConf.select(composed, path, default=None) for path in paths]
    return any(isinstance(n, DictConfig) and OmegaConf.is_struct(n) is False for n in nodes)


def _unknown(key: str, node: Mapping[str, Any]) -> str:
    """Return the error for a key that ``node`` does not have."""
    section = key.partition(".")[0]
    if key.startswith(_FORMER_LEARNERS) and "network" in node:
        names = ", ".join(registered_names(Learner.kind))
        return (
            f"{key}: a learner is chosen by its name, agent=NAME ({names}), and its settings "
            "follow as agent.SETTING"
        )
    if section not in node and section in TrainConfig.model_fields.keys() - {"seed"}:
        return f"{key}: it belongs to a training, and has no meaning here"
    return explain_unknown_key(key, node)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
