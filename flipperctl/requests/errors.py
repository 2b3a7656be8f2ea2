"""Explain wrong keys and choices: the known ones, and a close match.

In: an exception of Hydra or OmegaConf, or a request. Out: one of the package's own exceptions, in
one line. The text of an exception is never parsed.
"""

from __future__ import annotations

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
from yaml import YAMLError

from flipperctl.api import Learner
from flipperctl.api.plugin import registered_names
from flipperctl.config import TrainConfig
from flipperctl.config.defaults import CHOICES, missing_entry
from flipperctl.config.merge import MISSING, find
from flipperctl.config.sampled import SECTIONS
from flipperctl.config.words import unreadable
from flipperctl.errors import ConfigError, RequestError, missing_extra
from flipperctl.requests.request import Request
from flipperctl.text.messages import explain_unknown_key

_FORMER_LEARNERS = ("method", "agent.learner", "agent.policy_gradient")
"""Keys by which learners were chosen before they were plugins."""
_LAUNCHERS = ("joblib", "ray", "rq", "submitit")
"""Launchers of Hydra that are packages of their own, hydra-NAME-launcher."""


@contextmanager
def convert_hydra_errors() -> Iterator[None]:
    """Convert errors of Hydra and OmegaConf to the package's own, in one line."""
    try:
        yield
    except OverrideParseException as error:
        raise unreadable(str(error.override)) from error
    except MissingConfigException as error:
        raise missing_choice(error) from error
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        raise ConfigError(_one_line(error)) from error


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
    if group == "hydra/launcher" and option.partition("_")[0] in _LAUNCHERS:
        package = f"hydra-{option.partition('_')[0]}-launcher"
        return missing_extra(f"{group}={option}", package)
    return missing_entry(group, option, options)


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
    name = key.removeprefix("randomise.")
    for sampled in SECTIONS:
        if section == "randomise" and name in (node.get(sampled) or {}):
            return f"{key}: there is no such key (did you mean randomise.{sampled}.{name}?)"
    if section not in node and section in TrainConfig.model_fields.keys() - {"seed"}:
        return f"{key}: it belongs to a training, and has no meaning here"
    return explain_unknown_key(key, node)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
