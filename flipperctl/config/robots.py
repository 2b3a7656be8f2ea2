"""Robots by name and from files: ``robot=nubot``, ``robot=my_robot.yaml``.

In: a name of ``configs/robot``, or the path of a file that has settings of the robot. Out: the
robot, or the overrides that stand for the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from flipperctl.api import Robot, Sensor
from flipperctl.config import strict_yaml
from flipperctl.config.randomise import Randomise
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match, explain

_SUFFIXES = (".yaml", ".yml")
_KEY = "robot"
_ALIKE = 0.02
"""Relative difference of lengths that makes none [-]."""


def known_robots() -> list[str]:
    """Return the names of the robots that the package has."""
    folder = files("flipperctl.configs.robot")
    return sorted(Path(f.name).stem for f in folder.iterdir() if f.name.endswith(_SUFFIXES))


def is_file(name: str) -> bool:
    """Return whether a robot is named by a file instead of a preset."""
    return name.lower().endswith(_SUFFIXES)


def named_robot(name: str) -> Robot:
    """Return the robot of a preset or of a file; those that a file leaves out are nubot's."""
    if is_file(name):
        return read_robot(Path(name))
    if name not in (known := known_robots()):
        raise ConfigError(
            f"{_KEY}: there is no robot {name!r}{close_match(name, known)}; known: "
            f"{', '.join(known)}; a file of your own ends in .yaml"
        )
    return _checked(
        strict_yaml.read(files("flipperctl.configs.robot") / f"{name}.yaml", f"{_KEY}={name}"),
        f"{_KEY}={name}",
    )


def read_robot(file: Path) -> Robot:
    """Return the robot that a file describes."""
    return _checked(strict_yaml.read(file, str(file)), str(file))


def robot_or_name(value: object) -> object:
    """Return the robot that a text names; anything else is returned as it is."""
    return named_robot(value) if isinstance(value, str) else value


def notes_on_samples(robot: Robot, randomise: Randomise) -> Iterator[str]:
    """Yield a line for each setting of another robot that is sampled around that of nubot.

    The named conditions have ranges for nubot; with another robot, its own value may lie outside.
    """
    for one in randomise.sampled():
        if one.section != _KEY:
            continue
        own, (low, high) = getattr(robot, one.field, None), one.ends
        if own is None:  # a factor, or a load of none
            continue
        if own != Robot.model_fields[one.field].default and not low <= own <= high:
            yield (
                f"{one.key}: no episode has the robot's {_KEY}.{one.field}={own:.4g}, since its "
                f"range is {low:g} to {high:g}; give a range around it, or {one.key}=null"
            )


def notes_on_body(robot: Robot, perception: Sensor, randomise: Randomise) -> Iterator[str]:
    """Yield a line if the body that hides ground from a sensor is not as long as the chassis."""
    body, length = getattr(perception, "body_length", None), robot.chassis_length
    hides = getattr(perception, "occlusion", False)
    hides = hides or randomise.find("perception", "occlusion") is not None
    if hides and body is not None and abs(body - length) > _ALIKE * length:
        yield (
            f"perception.body_length: a body of {body:.4g} m hides the ground below it, and the "
            f"robot.chassis_length is {length:.4g} m; perception.body_length={length:.4g} hides all"
        )


def expand_files(words: Sequence[str]) -> list[str]:
    """Return overrides in which ``robot=FILE`` is replaced by the settings of the file.

    All settings of the robot are written out, in place of those of a policy's training too; one
    that another word sets is left to that word.
    """
    given = {word.lstrip("+~").partition("=")[0] for word in words}
    return [found for word in words for found in _expand(word, given)]


def _expand(word: str, given: Iterable[str]) -> Iterator[str]:
    key, _, value = word.partition("=")
    name = value.strip().strip("'\"")
    if key != _KEY or not is_file(name):
        yield word
        return
    if "," in name and not Path(name).exists():
        raise ConfigError(
            f"{word}: one file is allowed; lists name robots of the package: "
            f"{', '.join(known_robots())}"
        )
    for field, setting in read_robot(Path(name)).model_dump(mode="json").items():
        if f"{_KEY}.{field}" not in given:
            yield f"{_KEY}.{field}={'null' if setting is None else repr(setting)}"


def _checked(found: Any, where: str) -> Robot:
    if not isinstance(found, dict):
        raise ConfigError(
            f"{where}: settings of the robot are allowed, as in chassis_length: 0.7; known: "
            f"{', '.join(Robot.model_fields)}"
        )
    try:
        return Robot(**found)
    except ValidationError as error:
        raise ConfigError(explain(error, where, Robot)) from error
