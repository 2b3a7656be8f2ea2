"""Refuse plugins that worker processes cannot find: those that a script or notebook defines.

In: the plugins of a configuration. Out: nothing, or the error that says what to do.
"""

from __future__ import annotations

from collections.abc import Iterable

from flipperctl.api import Measure, Plugin, registry
from flipperctl.config import EnvConfig, TrainConfig, resolver
from flipperctl.errors import PluginError

_SCRIPT = "__main__"


def check_training(config: TrainConfig) -> None:
    """Check the plugins of a training, whose episodes workers play unless it is exact.

    Raises:
        PluginError: a plugin is defined in the script or notebook that calls.
    """
    if config.train.mode != "exact":
        used = [*_environment(config), config.network, config.teacher.controller]
        _check(used, "train with train={'mode': 'exact'}")


def check_evaluation(config: EnvConfig, jobs: int, controller: str | None) -> None:
    """Check the plugins of an evaluation, whose episodes workers play if there are several jobs.

    Raises:
        PluginError: a plugin is defined in the script or notebook that calls.
    """
    if jobs > 1:
        own = [] if controller is None else [registry["controller", controller]]
        _check([*_environment(config), *own], "leave jobs at 1")


def _environment(config: EnvConfig) -> list[Plugin]:
    return [config.terrain, config.sim, config.perception, *config.rewards.values()]


def _check(used: Iterable[Plugin | type[Plugin] | None], otherwise: str) -> None:
    # Every measure is taken, whether a configuration names it or not.
    classes = [cls for (kind, _), cls in registry.items() if kind == Measure.kind]
    for one in used:
        if isinstance(one, Plugin):
            classes += [type(part) for part in resolver.nested_plugins(one)]
        elif one is not None:
            classes.append(one)
    for cls in classes:
        if cls.__module__ == _SCRIPT:
            raise PluginError(
                f"{cls.kind} {cls.plugin_name!r} is defined in this script or notebook, which "
                f"worker processes do not run: save it in a file and give plugins=[FILE], or "
                f"{otherwise}"
            )
