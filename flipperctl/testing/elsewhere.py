"""The check that a plugin gives in another process what it gives here, whatever came before.

In: a registered plugin. Out: a refusal that names the first thing that differs. Results may depend
on the settings, the input and the generators alone. They may not depend on the process, the hash of
a text, what a module or a class remembers, or the order of the calls.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
from collections.abc import Mapping, Sequence
from typing import Any

from flipperctl.api import Controller, Measure, Network, Plugin, registry
from flipperctl.config import EnvConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import beginning
from flipperctl.plugging import plugins
from flipperctl.rollout.pool import ProcessHost
from flipperctl.testing import policies, recorded
from flipperctl.testing.check import NotChecked, require

_SEEDS = (0, 1, 2)


def another_process(plugin: Plugin) -> None:
    """Check that another process, which takes the seeds in another order, gives the same."""
    # The seeds are taken in another order there, so that a memory of earlier ones shows.
    here = _results(plugin, _SEEDS)
    settings, module = resolver.to_dict(plugin), type(plugin).__module__
    child = _child(tuple(plugins.configured_paths()))
    there = child.call(_elsewhere, (module, plugin.kind, settings, _SEEDS[::-1]))
    if there is None:
        raise NotChecked("another process does not find its class; define it in a file or a module")
    for what, result in here.items():
        require(
            result == there.get(what, result),  # a slow controller decides less often there
            f"{what} differs in another process; only its settings, what it is given and the "
            "generators that it is handed may decide",
        )


_children: dict[tuple[str, ...], ProcessHost] = {}
"""The process of the last check, by the paths of its plugins."""


def _child(paths: tuple[str, ...]) -> ProcessHost:
    """Return a process with the plugins of these paths, the same for one check after the other."""
    if paths not in _children:
        _end_children()
        _children[paths] = ProcessHost()
        _children[paths].call(plugins.load, (paths,))
    return _children[paths]


@atexit.register
def _end_children() -> None:
    while _children:
        _children.popitem()[1].end()


def _elsewhere(
    module: str, kind: str, settings: Mapping[str, Any], seeds: Sequence[int]
) -> dict[str, object] | None:
    """Return the results of a plugin in this process; None if its class is not registered here."""
    # A class that no plugin file holds is registered once its module is imported.
    if (kind, settings["name"]) not in registry:
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    if (kind, settings["name"]) not in registry:
        return None
    return _results(resolver.create(kind, settings, kind), seeds)


def _results(plugin: Plugin, seeds: Sequence[int]) -> dict[str, object]:
    """Return what a plugin gives, by what it is."""
    if isinstance(plugin, Network):
        return {"a Q-value": policies.untrained_values(plugin)}
    if isinstance(plugin, Controller):
        actions = policies.first_actions(plugin)
        return {f"its action at decision {at}": action for at, action in enumerate(actions)}
    if isinstance(plugin, Measure):
        return {"its value": recorded.first_value(plugin)}

    # All others act within an environment, with the plain one of each other kind.
    scene: dict[str, Any] = {"terrain": recorded.Ground(points=recorded.SCENES[0].points)}
    scene["rewards"] = {"none": recorded.NoReward()}
    if plugin.kind == "reward":
        scene["rewards"] = {"term": plugin}
    else:
        scene[plugin.kind] = plugin
    env = FlipperEnv(config=EnvConfig(**scene))
    return {
        f"{what.removeprefix('their ')} with seed {seed}": result
        for seed in seeds
        for what, result in beginning(env, seed)
    }
