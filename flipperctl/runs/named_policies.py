"""Policies that a user names: controllers, shipped policies, runs, checkpoints or exported files.

In: names, and changed fields of the controllers among them. Out: the policies' sources.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.api import Controller, Robot
from flipperctl.config import resolver
from flipperctl.errors import ConfigError, RequestError
from flipperctl.messages import close_match
from flipperctl.policies.source import PolicySource
from flipperctl.runs.inherited import find_policy


def controllers(names: str | None, option: str, default: Sequence[str] = ()) -> list[PolicySource]:
    """Return controllers at their defaults; ``names`` are separated by commas.

    ``default`` is used if ``names`` is None; the name ``none`` stands for no controller.

    Raises:
        RequestError: a name is empty, or ``none`` stands beside other names.
        ConfigError: there is no such controller.
    """
    chosen = default if names is None else [] if names == "none" else names.split(",")
    if "none" in chosen:
        raise RequestError(f"{option}: none stands alone, without other names; got {names}")
    if not all(chosen):
        raise RequestError(f"{option}: names between commas, or none, are allowed; got {names!r}")
    return [PolicySource.of_plugin(name.strip(), option) for name in chosen]


def policy_labels(names: str) -> list[str]:
    """Return the names of policies to compare, which are separated by commas.

    Raises:
        RequestError: there are fewer than two names, or one is repeated.
    """
    labels = [name.strip() for name in names.split(",")]
    if len(set(labels)) < max(2, len(labels)) or not all(labels):
        raise RequestError(
            f"--compare: at least two different names are allowed, as in level,okada; got {names!r}"
        )
    return labels


def policies(
    labels: Sequence[str], fields: Mapping[str, Any], tell: Callable[[str], None]
) -> dict[str, PolicySource]:
    """Return the named policies; ``fields`` apply to each controller that has such a field.

    ``tell`` is called with a line if a run has no best policy yet.

    Raises:
        ConfigError: there is no such policy, or no controller has one of the fields.
        CheckpointError: a checkpoint cannot be read.
    """
    sources = {label: _source(label, fields, tell) for label in labels}
    known = {name for s in sources.values() for name in s.settings or {} if name != "name"}
    for field in fields:
        if field not in known:
            raise ConfigError(
                f"controller.{field}: no compared controller has such a field"
                f"{close_match(field, sorted(known))}; known: {', '.join(sorted(known)) or 'none'}"
            )
    return sources


def _source(label: str, fields: Mapping[str, Any], tell: Callable[[str], None]) -> PolicySource:
    path = Path(label)
    if path.exists() or label in checkpoints.shipped_policies():
        return PolicySource(checkpoint=find_policy(path, tell))
    known = resolver.get("controller", label, "--compare").model_fields
    own = {name: value for name, value in fields.items() if name in known}
    made: Controller = resolver.create("controller", {"name": label, **own}, "controller")
    return PolicySource(settings=resolver.to_dict(made))


def common_robot(sources: Mapping[str, PolicySource], chosen: Collection[str]) -> Robot:
    """Return the robot of the files among the policies; the default one if there are none.

    The robots of the files may differ in the overridden keys, ``chosen``.

    Raises:
        ConfigError: the files are for different robots.
    """
    robots = {name: robot for name, s in sources.items() if (robot := s.robot()) is not None}
    if not robots:
        return Robot()
    (first, ours), *others = robots.items()
    for other, theirs in others:
        for field in Robot.model_fields:
            values = getattr(ours, field), getattr(theirs, field)
            key = f"robot.{field}"
            if values[0] != values[1] and key not in chosen:
                first_value, value = ("null" if v is None else f"{v:.6g}" for v in values)
                raise ConfigError(
                    f"--compare: {first} is for {key}={first_value}, {other} for "
                    f"{value}; give {key}=… to choose the robot"
                )
    return ours
