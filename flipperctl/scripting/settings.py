"""Keyword arguments as the overrides that the commands take, with the plugins of this process.

In: Python values by configuration key. Out: words in Hydra's grammar, ``key=value``; plugins at the
begin of every function of the interface; short errors; and a refusal of plugins that a script or
notebook defines and worker processes cannot find.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from enum import Enum
from typing import ParamSpec, TypeVar

import numpy as np

from flipperctl.api import Measure, Plugin, Settings, registry
from flipperctl.config import EnvConfig, TrainConfig, resolver, to_dict
from flipperctl.config.defaults import CHOICES, LISTS
from flipperctl.config.words import quoted
from flipperctl.errors import ConfigError, PluginError, RequestError
from flipperctl.plugging import plugins as registered
from flipperctl.process import entry
from flipperctl.process.session import remember_plugins
from flipperctl.process.undisturbed import undisturbed
from flipperctl.terminal.streams import begin_notices
from flipperctl.text.files import at_home

Paths = Sequence[str | os.PathLike[str]]


def begin(plugins: Paths) -> None:
    """Load the installed plugins and those at these paths, ``.py`` files or folders."""
    if isinstance(plugins, str | os.PathLike):
        raise RequestError(f"plugins: a list of paths is allowed; the value is {plugins!r}")
    begin_notices()
    paths = [os.fspath(path) for path in plugins]
    remember_plugins(paths)
    registered.load(paths)


P = ParamSpec("P")
T = TypeVar("T")


def public(function: Callable[P, T]) -> Callable[P, T]:
    """Make a function a door: ``~`` in its arguments is the home folder, see ``at_home``.

    The caller's process keeps its state, see ``undisturbed``. The errors behind a refused request
    are left out of its traceback, since its text has them. With ``FLIPPERCTL_DEBUG=1`` they stay.
    """
    return _door(function, undisturbed)


def deciding(function: Callable[P, T]) -> Callable[P, T]:
    """Make a decision of a file's policy a door, see ``public``: networks draw none of numpy's."""
    return _door(function, functools.partial(undisturbed, draws_from_numpy=False))


def _door(
    function: Callable[P, T], context: Callable[[], AbstractContextManager[None]]
) -> Callable[P, T]:
    @functools.wraps(function)
    def door(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            with context():
                return function(*at_home(args), **at_home(kwargs))
        except RequestError as error:
            if os.environ.get(entry.DEBUG) != "1":
                error.__cause__ = None
            raise

    return door


_TERM = re.compile(r"rewards\.[^.]+")
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_RESERVED = {"null", "true", "false", "nan", "inf"}
"""Words that Hydra does not read as text, in any case."""
_REWARDS = "controller.rewards"
"""End of the keys of settings whose value is a mapping of reward terms."""


def words(settings: Mapping[str, object], overrides: Sequence[str] = ()) -> list[str]:
    """Return the overrides of the settings, and behind them those that are written already.

    Keys may be dotted. A mapping sets the fields below its key; the ``name`` in it, or a plugin's
    settings as an object, choose a plugin as well. Several names of a choice are several scenes. A
    reward term that is None is dropped, and an empty mapping of rewards drops all terms. The
    rewards of a controller are one setting: a preset's name, or all terms.

    Raises:
        ConfigError: a value cannot be a setting.
    """
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: a list of words is allowed; the value is {overrides!r}")
    found = [word for key, value in settings.items() for word in _words(key, _plain(value))]
    return [*found, *overrides]


def _words(key: str, value: object) -> Iterator[str]:
    if (key == "rewards" and value == {}) or (_TERM.fullmatch(key) and value is None):
        yield f"~{key}"
    elif isinstance(value, Mapping) and value and not key.endswith(_REWARDS):
        fields = {str(name): _plain(inner) for name, inner in value.items()}
        if key in CHOICES and "name" in fields:
            yield f"{key}={literal(fields.pop('name'), key)}"
        for name, inner in fields.items():
            yield from _words(f"{key}.{name}", inner)
    elif key in CHOICES and key not in LISTS and isinstance(value, list) and value:
        if not all(isinstance(name, str) for name in value):
            raise ConfigError(f"{key}: names are allowed in a list; the value is {value!r}")
        yield f"{key}={','.join(literal(name, key) for name in value)}"
    else:
        yield f"{key}={literal(value, key)}"


def literal(value: object, key: str) -> str:
    """Return a value in Hydra's grammar, where a text stands for itself.

    ``key`` is that of the setting, for the error.
    """
    value = _plain(value)
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        bare = _NAME.fullmatch(value) and value.lower() not in _RESERVED
        return value if bare else quoted(value)
    if isinstance(value, list):
        return f"[{','.join(literal(item, key) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(_entry(name, item, key) for name, item in value.items())}}}"
    raise ConfigError(
        f"{key}: {value!r} is no setting; numbers, texts, paths, None, lists, mappings and "
        "settings of plugins are allowed"
    )


def _entry(name: object, value: object, key: str) -> str:
    if not (isinstance(name, str) and _NAME.fullmatch(name)):
        raise ConfigError(f"{key}: {name!r} is no name of a field in a list; letters and _ are")
    return f"{name}:{literal(value, key)}"


def _plain(value: object) -> object:
    """Return the value without the types of numpy, paths, tuples, enumerations and settings."""
    if isinstance(value, Settings):
        return to_dict(value, brief=True)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, range | tuple):
        return list(value)
    return value


def check_training(config: TrainConfig) -> None:
    """Check the plugins of a training, whose episodes workers play unless it is exact."""
    if config.train.mode != "exact":
        others = [config.network, config.teacher.controller]
        _check(config, others, "train with train={'mode': 'exact'}")


def check_evaluation(config: EnvConfig, jobs: int, controller: str | None) -> None:
    """Check the plugins of an evaluation, whose episodes workers play if there are several jobs."""
    if jobs > 1:
        _check(
            config, [registry["controller", controller]] if controller else [], "leave jobs at 1"
        )


def _check(
    config: EnvConfig | TrainConfig, others: Sequence[Plugin | type[Plugin] | None], otherwise: str
) -> None:
    # Every measure is taken, whether a configuration names it or not.
    classes = [cls for (kind, _), cls in registry.items() if kind == Measure.kind]
    own = [config.terrain, config.sim, config.perception, *config.rewards.values()]
    for one in [*own, *others]:
        if isinstance(one, Plugin):
            classes += [type(part) for part in resolver.nested_plugins(one)]
        elif one is not None:
            classes.append(one)
    for cls in classes:
        if cls.__module__ == "__main__":
            raise PluginError(
                f"{cls.kind} {cls.plugin_name!r} is defined in this script or notebook, which "
                f"worker processes do not run: save it in a file and give plugins=[FILE], or "
                f"{otherwise}"
            )
