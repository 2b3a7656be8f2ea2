"""Policies that a user names: controllers, shipped policies, runs, checkpoints or exported files.

In: names, and changed fields of the controllers among them. Out: the policies' sources.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.api import Controller, Robot, registry
from flipperctl.checkpoint import shipped_policies
from flipperctl.config import resolver
from flipperctl.config.words import check_different
from flipperctl.errors import ConfigError, RequestError
from flipperctl.messages import close_match
from flipperctl.policies.source import PolicySource
from flipperctl.runs.inherited import find_policy


def require_one_policy(
    checkpoint: Path | None, controller: str | None, overrides: Sequence[str] | None
) -> None:
    """Check that exactly one of the two is given; suggest a word without ``=`` as one.

    Raises:
        RequestError: none or both are given.
    """
    if (checkpoint is None) != (controller is None):
        return
    words = [word for word in overrides or () if "=" not in word and not word.startswith("~")]
    if checkpoint is None and words:
        raise RequestError(
            f"{words[0]}: give either --checkpoint {words[0]}, if it is a run, a file or a shipped "
            f"policy, or --controller {words[0]}, if it is a controller"
        )
    raise RequestError("give either --checkpoint RUN_OR_FILE or --controller NAME")


def refuse_beside(option: str, others: Mapping[str, Any]) -> None:
    """Refuse options that have no meaning beside ``option``; ``others`` has their values.

    Raises:
        RequestError: one of them is given.
    """
    for name, value in others.items():
        if value:
            name = name if name == "overrides" or "=" in name else f"--{name}"
            raise RequestError(f"{name}: no meaning beside {option}; leave it out")


def controller_or_okada(checkpoint: Path | None, controller: str | None) -> str | None:
    """Return the controller to evaluate, by default okada; None if a checkpoint is given.

    Raises:
        RequestError: both are given.
    """
    if checkpoint is not None and controller is not None:
        raise RequestError("give --checkpoint or --controller, not both")
    return None if checkpoint else controller or "okada"


def controllers(names: str | None, option: str, default: Sequence[str] = ()) -> list[PolicySource]:
    """Return controllers at their ``reference_settings``; ``names`` are separated by commas.

    ``default`` is used if ``names`` is None; the name ``none`` stands for no controller.

    Raises:
        RequestError: a name is empty or that of a file, or ``none`` stands beside other names.
        ConfigError: there is no such controller.
    """
    chosen = default if names is None else [] if names == "none" else names.split(",")
    if "none" in chosen:
        raise RequestError(f"{option}: none stands alone, without other names; got {names}")
    if not all(chosen):
        raise RequestError(f"{option}: names between commas, or none, are allowed; got {names!r}")
    found = [name.strip() for name in chosen]
    check_different(option, found)
    for name in found:
        refuse_file(name, option)
    return [PolicySource.of_plugin(name, option) for name in found]


def refuse_file(name: str, option: str) -> None:
    """Refuse a shipped policy, a run or a file where ``option`` takes controllers.

    Raises:
        RequestError: ``name`` is one of them, and no controller.
    """
    if ("controller", name) in registry:
        return
    if name in shipped_policies() or Path(name).exists():
        raise RequestError(
            f"{option}: controllers are allowed, and {name} is none; add --checkpoint {name}, "
            "which may be repeated: policies stand in one table, on the same episodes"
        )


def policies(
    names: str,
    fields: Mapping[str, Any],
    tell: Callable[[str], None],
    option: str = "--compare",
    fewest: int = 2,
) -> dict[str, PolicySource]:
    """Return the named policies; ``fields`` apply to each controller that has such a field.

    ``names`` are separated by commas and were given with ``option``. ``tell`` is called with a line
    if a run has no best policy yet.

    Raises:
        RequestError: there are fewer than ``fewest`` names, or one is repeated.
        ConfigError: there is no such policy, or no controller has one of the fields.
        CheckpointError: a checkpoint cannot be read.
    """
    labels = [name.strip() for name in names.split(",")]
    if len(set(labels)) < max(fewest, len(labels)) or not all(labels):
        least = "two different names are" if fewest > 1 else "one name is"
        allowed = f"at least {least} allowed, as in level,okada, each once"
        raise RequestError(f"{option}: {allowed}; got {names!r}")
    sources = {label: _source(label, fields, tell, option) for label in labels}
    known = {name for s in sources.values() for name in s.settings or {} if name != "name"}
    for field in fields:
        if field not in known:
            raise ConfigError(
                f"controller.{field}: no controller of {option} has such a field"
                f"{close_match(field, sorted(known))}; known: {', '.join(sorted(known)) or 'none'}"
            )
    return sources


def _source(
    label: str, fields: Mapping[str, Any], tell: Callable[[str], None], option: str
) -> PolicySource:
    path = Path(label)
    if path.exists() or label in shipped_policies():
        return PolicySource(checkpoint=find_policy(path, tell))
    known = resolver.get("controller", label, option).model_fields
    own = {name: value for name, value in fields.items() if name in known}
    settings = {**resolver.reference(label, option), **own}
    made: Controller = resolver.create("controller", settings, "controller")
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
            if values[0] != values[1] and not {"robot", key} & set(chosen):
                first_value, value = ("null" if v is None else f"{v:.6g}" for v in values)
                raise ConfigError(
                    f"--compare: {first} is for {key}={first_value}, {other} for "
                    f"{value}; give {key}=… to choose the robot"
                )
    return ours
