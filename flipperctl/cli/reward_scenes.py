"""The scenes, rewards and policies that ``inspect reward --compare`` compares.

In: overrides and names of policies. Out: scenes with one or several sets of reward terms each, and
the policies' sources.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.api import Controller, Robot
from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.combinations import combinations
from flipperctl.cli.hydra.errors import convert_hydra_errors
from flipperctl.cli.hydra.overrides import check_words, override_values, parse_overrides
from flipperctl.cli.policy_file import find_policy
from flipperctl.config import resolver
from flipperctl.errors import ConfigError, RequestError
from flipperctl.messages import close_match
from flipperctl.policies.source import PolicySource
from flipperctl.studies.reward_comparison import Rewards, RewardScene

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""


def reward_scenes(
    overrides: Sequence[str], sources: Mapping[str, PolicySource]
) -> list[RewardScene]:
    """Return a scene for each combination of the lists that do not concern the rewards.

    Lists that concern the rewards, as ``rewards=paper,tuned``, give the sets of each scene. The
    robot is that of the files among the ``sources``, whose names are for errors.

    Raises:
        ConfigError: an override is wrong, or drops every reward term, or the files are for
            different robots and no override says which one drives.
    """
    config_store.register_defaults()
    check_words(overrides)
    primary = config_store.register_robot(_robot(overrides, sources))
    found: dict[tuple[str, ...], dict[str, Rewards]] = {}
    configs = {}
    with convert_hydra_errors():
        chosen = list(combinations(overrides))
    for combination in chosen:
        parts = [(o, _concerns_rewards(o)) for o in combination]
        scene = tuple(o for o, rewards in parts if not rewards)
        label = " ".join(o.removeprefix("rewards=") for o, rewards in parts if rewards)
        ((config, _),) = compose.compose_eval(combination, primary)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term, by which nothing can be ranked")
        configs[scene] = config
        found.setdefault(scene, {})[label or _DEFAULT] = config.rewards
    return [RewardScene(configs[scene], rewards) for scene, rewards in found.items()]


def _robot(overrides: Sequence[str], sources: Mapping[str, PolicySource]) -> Robot:
    """Return the robot of the files, beside the fields that overrides set; see above."""
    robots = {name: robot for name, s in sources.items() if (robot := s.robot()) is not None}
    if not robots:
        return Robot()
    with convert_hydra_errors():
        chosen = {o.key_or_group for o in parse_overrides(overrides)}
    (first, ours), *others = robots.items()
    for other, theirs in others:
        for field in Robot.model_fields:
            values = getattr(ours, field), getattr(theirs, field)
            key = f"robot.{field}"
            if values[0] != values[1] and key not in chosen:
                first_value, value = ("null" if v is None else f"{v:.6g}" for v in values)
                raise ConfigError(
                    f"--compare: {first} is for {key}={first_value}, {other} for "
                    f"{value}; give {key}=… for the robot that both drive"
                )
    return ours


def policies(names: str, overrides: Sequence[str]) -> tuple[dict[str, PolicySource], list[str]]:
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
    check_words(overrides)
    with convert_hydra_errors():
        parsed = parse_overrides(overrides)
        own = [str(o.input_line) for o in parsed if o.key_or_group.startswith("controller.")]
        fields = {k.removeprefix("controller."): v for k, v in override_values(own).items()}
    if any(o.key_or_group == "controller" for o in parsed):
        raise RequestError("controller: --compare names the controllers; leave the override out")
    sources = {label: _source(label, fields) for label in labels}
    _check_fields(fields, sources)
    return sources, [str(o.input_line) for o in parsed if str(o.input_line) not in own]


def _source(label: str, fields: Mapping[str, Any]) -> PolicySource:
    path = Path(label)
    if path.exists() or label in checkpoints.shipped_policies():
        return PolicySource(checkpoint=find_policy(path))
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


def _concerns_rewards(override: str) -> bool:
    return _REWARD_KEY.match(override) is not None
