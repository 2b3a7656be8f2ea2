"""A policy in several engines on the same episodes (``eval … sim=planar,mujoco``).

In: the result of an evaluation whose scenes are played in the default engine and in another one,
and there with a sensor if one maps the ground. Out: the steps from one to the next, and why the
episodes of the last one failed. Friction, gravity, ground and start are equal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeVar

from flipperctl.api import SharedSetting
from flipperctl.config import DEFAULT_ENGINE, EnvConfig, EvalConfig, resolver
from flipperctl.errors import ConfigError
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.failure_causes import explain, on_true_ground
from flipperctl.evaluation.rows import Episodes, reached

Config = TypeVar("Config", bound=EnvConfig)
_SHARED: tuple[SharedSetting, ...] = ("friction", "gravity")
"""Settings that the default engine takes from the other one."""


def in_default_engine(config: Config) -> Config:
    """Return the configuration in the default engine, with the same friction and gravity."""
    sim = config.sim
    if sim.plugin_name == DEFAULT_ENGINE:
        return config
    # Friction and gravity must be equal for a comparison of engines.
    known = {name: sim.shared_setting(name) for name in _SHARED}
    shared: dict[str, Any] = {name: value for name, value in known.items() if value is not None}
    plane = resolver.create("sim", {"name": DEFAULT_ENGINE, **shared}, "sim")
    # A sampled setting that one engine lacks would make unequal episodes.
    sampled = (setting for setting in config.randomise.sampled() if setting.section == "sim")
    if foreign := [
        setting.key for setting in sampled if setting.field not in type(plane).model_fields
    ]:
        raise ConfigError(
            f"{', '.join(foreign)}: sim={DEFAULT_ENGINE}, the engine to compare with, has no such "
            f"setting; add {' '.join(f'{key}=null' for key in foreign)}"
        )
    return config.model_copy(update={"sim": plane})


def steps(config: EvalConfig) -> list[EvalConfig]:
    """Return the configurations that lead from the default engine to ``config``.

    With a sensor such as ``lidar``, both engines perceive the true ground, and the last step adds
    the sensor.
    """
    exact = on_true_ground(config)
    truly = config if exact is None else exact
    return [in_default_engine(truly), truly, *([] if exact is None else [config])]


def explained(result: Result) -> Result:
    """Return the result with the cause of each failure in the last step, found by playing again."""
    causes: dict[int, Played] = {}
    for group in comparisons(result):
        first, last = group[0], group[-1]
        ends = {row["seed"]: row for row in first.episodes}
        rows = tuple(
            row if reached(row) else row | explain(last.entry.config, last.entry.source, row)
            for row in last.episodes
            if row["seed"] in ends
        )
        causes[id(last)] = replace(last, episodes=Episodes(rows))
    return replace(result, played=tuple(causes.get(id(item), item) for item in result.played))


def comparisons(result: Result) -> Iterator[list[Played]]:
    """Yield the two or three steps of each policy on each terrain, if all were played."""
    groups: dict[int, list[Played]] = {}
    for item in result.played:
        if item.entry.comparison is not None:
            groups.setdefault(item.entry.comparison, []).append(item)
    for number, group in groups.items():
        planned = [e for e in result.plan.entries if e.comparison == number]
        whole = all(len(item.episodes) == len(group[0].episodes) for item in group)
        if len(group) == len(planned) and whole:
            yield group
