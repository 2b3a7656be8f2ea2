"""Conversion of checkpoints whose learners were no plugins, or whose settings had other names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flipperctl.api import registry
from flipperctl.config.sampled import FIRST, SECTIONS

_PRIORITY = 0.6
_STATE = ("replay_added", "replay_kept", "groups_added")


def current(config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the plain configuration of a training with its learner as a plugin.

    Before, ``agent`` had the settings of two learners and ``learner`` chose one; ``method`` had
    the settings of Stable-Baselines3. Engines had a setting whose value is fixed now.
    """
    config = with_paths(config)
    agent, method = config.get("agent"), config.get("method")
    if not isinstance(agent, Mapping):
        return config
    # Before, errors were computed anew for some candidates, and a run of those cannot be resumed.
    if (candidates := agent.get("candidates")) is not None:
        agent = {key: value for key, value in agent.items() if key != "candidates"}
        agent |= {"priority": _PRIORITY} if candidates != 1 else {}
        config = {**config, "agent": agent}
    # A learner with a name is a plugin already.
    if "name" in agent:
        return config
    # The learner keeps the settings that it still has; engines lose the one that is fixed.
    name = "sb3" if method else agent.get("learner", "d3qn")
    settings = {**agent, **agent.get("policy_gradient", {}), **(method or {})}
    known = registry["agent", name].model_fields
    fields = {key: value for key, value in settings.items() if key in known}
    sim = {k: v for k, v in config.get("sim", {}).items() if (k, v) != ("engine", "compiled")}
    rest = {key: value for key, value in config.items() if key != "method"}
    return {**rest, "sim": sim, "agent": {**fields, "name": name}}


def with_paths(config: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a plain configuration whose sampled settings are in sections, as in ``sim.friction``.

    Before, common ones were ``friction`` alone, and were null if they were not sampled.
    """
    ranges = config.get("randomise")
    if not isinstance(ranges, Mapping):
        return config
    sections = {path.partition(".")[2]: path.partition(".")[0] for path in FIRST}
    rest = {name: value for name, value in ranges.items() if name not in sections}
    paths: dict[str, Any] = {"spread": None, **{section: {} for section in SECTIONS}, **rest}
    for name, value in ranges.items():
        if name in sections and value is not None:
            section = sections[name]
            paths[section] = {**paths[section], name: value}
    return {**config, "randomise": paths}


def document(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the plain document of a checkpoint, whose state names no parts of a learner."""
    state = raw.get("state")
    if not isinstance(state, dict) or not state.keys() >= {*_STATE}:
        return raw
    orders = [{k: v for k, v in order.items() if k != "epsilon"} for order in state["orders"]]
    rest = {name: value for name, value in state.items() if name not in _STATE}
    return {**raw, "state": {**rest, "orders": orders, "parts": [], "learner": {}}}
