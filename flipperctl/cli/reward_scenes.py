"""The scenes, rewards and policies that ``inspect reward --compare`` compares.

In: overrides and names of policies. Out: scenes with one or several sets of reward terms each, and
the policies' sources.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.api import Controller, Robot
from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import resolver
from flipperctl.errors import ConfigError, RequestError
from flipperctl.messages import close_match
from flipperctl.policies.source import PolicySource
from flipperctl.runs.inherited import find_policy
from flipperctl.studies.reward_comparison import Rewards, RewardScene
from flipperctl.terminal.streams import print_note

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""
_FIELD = "controller."


def reward_scenes(overrides: Overrides, sources: Mapping[str, PolicySource]) -> list[RewardScene]:
    """Return a scene for each combination of the lists that do not concern the rewards.

    Lists that concern the rewards, as ``rewards=paper,tuned``, give the sets of each scene. The
    robot is that of the files among the ``sources``, whose names are for errors.

    Raises:
        ConfigError: an override is wrong, or drops every reward term, or the files are for
            different robots and no override says which one drives.
    """
    config_store.register_defaults()
    primary = config_store.register_robot(_robot(overrides.typed, sources))
    found: dict[tuple[str, ...], dict[str, Rewards]] = {}
    configs = {}
    for combination in overrides.combinations(config_store.CHOICES):
        parts = [(word, _REWARD_KEY.match(word) is not None) for word in combination.words]
        scene = tuple(word for word, rewards in parts if not rewards)
        label = " ".join(word.removeprefix("rewards=") for word, rewards in parts if rewards)
        ((config, _),) = compose.compose_eval(combination, primary)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term, by which nothing can be ranked")
        configs[scene] = config
        found.setdefault(scene, {})[label or _DEFAULT] = config.rewards
    return [RewardScene(configs[scene], rewards) for scene, rewards in found.items()]


def _robot(chosen: Collection[str], sources: Mapping[str, PolicySource]) -> Robot:
    """Return the robot of the files, beside the fields that overrides set; see above."""
    robots = {name: robot for name, s in sources.items() if (robot := s.robot()) is not None}
    if not robots:
        return Robot()
    (first, ours), *others = robots.items()
    for other, theirs in others:
        for field in Robot.model_fields:
            values = getattr(ours, field), getattr(theirs, field)
            key = f"robot.{field}"
            if values[0] != values[1] and key not in chosen:
                raise ConfigError(
                    f"--compare: {first} is for {key}={values[0]:.6g}, {other} for "
                    f"{values[1]:.6g}; give {key}=… for the robot that both drive"
                )
    return ours


def policies(names: str, words: Sequence[str]) -> tuple[dict[str, PolicySource], Overrides]:
    """Return the named policies, and the overrides without those of the controllers.

    ``names`` are controllers, shipped policies, runs, checkpoints or exported files, separated by
    commas. An override of ``controller.<field>`` applies to each controller with such a field.

    Raises:
        RequestError: there are not two policies, or one is named twice.
        ConfigError: there is no such policy, or no controller has an overridden field.
        CheckpointError: a checkpoint cannot be read.
    """
    labels = [name.strip() for name in names.split(",")]
    if len(set(labels)) < max(2, len(labels)) or not all(labels):
        raise RequestError(
            f"--compare: at least two different names are allowed, as in level,okada; got {names!r}"
        )
    overrides = Overrides.parse(words)
    own = overrides.where(lambda key: key.startswith(_FIELD)).values()
    if "controller" in overrides.typed:
        raise RequestError("controller: --compare names the controllers; leave the override out")
    fields = {key.removeprefix(_FIELD): value for key, value in own.items()}
    sources = {label: _source(label, fields) for label in labels}
    _check_fields(fields, sources)
    return sources, overrides.where(lambda key: not key.startswith(_FIELD))


def _source(label: str, fields: Mapping[str, Any]) -> PolicySource:
    path = Path(label)
    if path.exists() or label in checkpoints.shipped_policies():
        return PolicySource(checkpoint=find_policy(path, print_note))
    known = resolver.get("controller", label, "--compare").model_fields
    own = {name: value for name, value in fields.items() if name in known}
    made: Controller = resolver.create("controller", {"name": label, **own}, "controller")
    return PolicySource(settings=resolver.container(made))


def _check_fields(fields: Mapping[str, Any], sources: Mapping[str, PolicySource]) -> None:
    """Refuse an override of a field that no compared controller has."""
    known = {name for s in sources.values() for name in s.settings or {} if name != "name"}
    for field in fields:
        if field not in known:
            raise ConfigError(
                f"controller.{field}: no compared controller has such a field"
                f"{close_match(field, sorted(known))}; known: {', '.join(sorted(known)) or 'none'}"
            )
