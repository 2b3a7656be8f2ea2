"""Keyword arguments as requests, with the plugins of this process.

In: Python values by configuration key. Out: requests; plugins at the begin of every function of the
interface; short errors; and a refusal of plugins that a script or notebook defines and worker
processes cannot find.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import ParamSpec, TypeVar

from flipperctl.api import Measure, Plugin, registry
from flipperctl.config import EnvConfig, TrainConfig, resolver
from flipperctl.errors import ConfigError, PluginError, RequestError
from flipperctl.plugging import plugins as registered
from flipperctl.process import entry
from flipperctl.process.session import remember_plugins
from flipperctl.process.undisturbed import undisturbed
from flipperctl.requests.request import Requests, from_values
from flipperctl.requests.text import from_words
from flipperctl.terminal.streams import begin_notices
from flipperctl.text.files import at_home
from flipperctl.text.messages import close_match

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
    arguments = inspect.signature(function).parameters

    @functools.wraps(function)
    def door(*args: P.args, **kwargs: P.kwargs) -> T:
        try:
            # A word that is no setting may be meant as an argument.
            for word in kwargs:
                known = word in arguments or word in TrainConfig.model_fields
                if not known and (meant := close_match(word, arguments)):
                    raise ConfigError(f"{word}: there is no such argument{meant}")
            with context():
                return function(*at_home(args), **at_home(kwargs))
        except RequestError as error:
            if os.environ.get(entry.DEBUG) != "1":
                error.__cause__ = None
            raise

    return door


def requested(settings: Mapping[str, object], overrides: Sequence[str]) -> Requests:
    """Return the requests of keyword arguments, and behind them those that are words.

    Raises:
        ConfigError: a value cannot be a setting, or a word is no override.
    """
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: a list of words is allowed; the value is {overrides!r}")
    return Requests.of(from_values(settings), from_words(overrides) if overrides else ())


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
    plugins = [config.terrain, config.sim, config.perception, *config.rewards.values()]
    for item in [*plugins, *others]:
        if isinstance(item, Plugin):
            classes += [type(part) for part in resolver.nested_plugins(item)]
        elif item is not None:
            classes.append(item)

    # A script or notebook is not there for a worker process.
    for cls in classes:
        if cls.__module__ == "__main__":
            raise PluginError(
                f"{cls.kind} {cls.plugin_name!r} is defined in this script or notebook, which "
                f"worker processes do not run: save it in a file and give plugins=[FILE], or "
                f"{otherwise}"
            )
