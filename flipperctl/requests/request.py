"""Requests: keys with values, whether they were typed or come from Python.

In: parsed words, or keyword arguments. Out: one ``Requests`` for all later steps: which values each
key has, and every combination of several values.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import Settings, registry
from flipperctl.api.plugin import registered_names
from flipperctl.config import policy_file, to_dict
from flipperctl.config.defaults import CHOICES, LISTS
from flipperctl.config.presets import presets
from flipperctl.config.resolver import is_robot_file, named_robot
from flipperctl.config.words import check_different, literal
from flipperctl.errors import ConfigError
from flipperctl.runtime.devices import SECTION, Devices, read_devices, robot_devices
from flipperctl.training.search import Interval

SEARCH_PATH = "hydra.searchpath"
"""Key of the folders with further configuration files."""
RUN_FOLDER = "hydra.run.dir"
"""Key of the directory of a single run."""
CONTROLLERS = {"controller": "controller", "teacher": "teacher.controller"}
"""Key that names a controller → section of its settings."""
_TERM = re.compile(r"rewards\.[^.]+")
_KEY = re.compile(r"(\+\+|\+|~|)([^@]*)(?:@(.*))?", re.DOTALL)


@dataclass(frozen=True)
class Several:
    """Several values of a key, each of which makes a combination."""

    requests: tuple[Request, ...]


@dataclass(frozen=True)
class Request:
    """A key with its value."""

    key: str
    """A setting, or a group whose entry is chosen by its name."""
    value: Any = None
    """Plain data, ``Several`` values or an ``Interval``."""
    prefix: str = ""
    """``+`` adds a key, ``++`` adds or changes it, ``~`` drops it; without one, it is changed."""
    package: str | None = None
    """Where the entry of a group belongs, as in ``reward@rewards.hit``."""
    typed: str = ""
    """The word that was typed, whose texts may refer to other settings; empty if there is none."""

    @property
    def path(self) -> str:
        """The key with its package."""
        return self.key if self.package is None else f"{self.key}@{self.package}"

    @property
    def place(self) -> str:
        """The setting or section that the request changes."""
        return self.key if self.package is None else self.package

    @property
    def name(self) -> str:
        """The key with its package and prefix."""
        return f"{self.prefix}{self.path}"

    @property
    def drops(self) -> bool:
        """Whether the key is dropped."""
        return self.prefix == "~"

    @property
    def text(self) -> str:
        """The word that was typed, or a word that has the same effect."""
        if self.typed or (self.drops and self.value is None):
            return self.typed or self.name
        if isinstance(self.value, Several):
            return f"{self.name}={','.join(literal(r.value) for r in self.value.requests)}"
        return f"{self.name}={literal(self.value)}"


@dataclass(frozen=True)
class Requests:
    """Requests in their order, each key once."""

    items: tuple[Request, ...] = ()
    body_alone: bool = False
    """Whether the devices in a robot's file are left out."""

    @classmethod
    def of(cls, *parts: Iterable[Request]) -> Requests:
        """Join requests.

        Raises:
            ConfigError: a key has two.
        """
        items = tuple(itertools.chain(*parts))
        earlier: dict[str, Request] = {}
        for request in items:
            if (other := earlier.setdefault(request.place, request)) is not request:
                raise ConfigError(
                    f"{request.place} is given twice: {other.text} and {request.text}; one is "
                    "allowed"
                )
        return cls(items)

    def __iter__(self) -> Iterator[Request]:
        return iter(self.items)

    @cached_property
    def expanded(self) -> tuple[Request, ...]:
        """The requests without files and short forms.

        A reward term that no preset has is added. The settings in the file of a robot or of a
        controller replace its name; what another request sets is left to that request.
        """
        paths, choice = {request.path for request in self}, self.choice("perception")
        sensor = registry.get(("perception", choice or ""))
        takes = sensor is not None and "mount_axis" in sensor.model_fields
        if SECTION in paths and sensor is not None and not takes:
            raise ConfigError(
                f"{SECTION}=FILE has the place and the widths of a LiDAR; perception=lidar is "
                f"allowed beside it, not {self.choice('perception')}"
            )
        parts = list(self)
        # The devices in a robot's file, unless another sensor is chosen
        takes = takes or (choice is None and "conditions" not in paths)
        robot = self.choice("robot")
        if not self.body_alone and SECTION not in paths and takes and has_devices(robot):
            parts.append(Request(SECTION, robot))
        return tuple(part for request in parts for part in _expand(request, paths))

    @property
    def words(self) -> list[str]:
        """The words with the same effect on a command line."""
        return [request.text for request in self.expanded]

    @property
    def typed(self) -> dict[str, str]:
        """The word that changes each key or group; a mapping changes all keys in it."""
        words: dict[str, str] = {}
        for request in self.expanded:
            words |= dict.fromkeys(_keys(request.key, request.value), request.text)
        return words

    @property
    def swept(self) -> list[str]:
        """Keys with several values, or with an interval."""
        return [r.name for r in self if isinstance(r.value, Several | Interval)]

    def devices(self) -> Devices | None:
        """Return those of ``devices=FILE``, or of a robot's file that has some."""
        for request in self:
            name, value = request.key, request.value
            if name == SECTION and isinstance(value, str):
                return read_devices(Path(value))
        robot = self.choice("robot")
        return robot_devices(Path(robot)) if robot is not None and has_devices(robot) else None

    @property
    def without_devices(self) -> Requests:
        """The requests without devices, those in a robot's file included."""
        return replace(self.where(lambda key: key != SECTION), body_alone=True)

    def where(self, accepts: Callable[[str], bool]) -> Requests:
        """Return the requests whose key a function accepts."""
        return Requests(tuple(request for request in self if accepts(request.key)))

    def choice(self, group: str) -> str | None:
        """Return the name that was chosen last for a group; None if there is none."""
        requests = [request for request in self if request.key == group]
        value = requests[-1].value if requests and not requests[-1].drops else None
        return str(value) if value else None

    def values(self) -> dict[str, Any]:
        """Return the value of each key, for changes of a configuration that exists.

        Raises:
            ConfigError: a key is added or dropped, or has several values.
        """
        for request in self.expanded:
            if request.prefix or isinstance(request.value, Several | Interval):
                raise ConfigError(f"{request.text}: one value is allowed here, as in key=value")
        return {request.key: request.value for request in self.expanded}

    def check_training(self, *, several: bool) -> None:
        """Refuse lists without ``several`` runs, empty folders, and what ``check`` refuses."""
        for request in self:
            if isinstance(request.value, Several | Interval) and not several:
                name, _, value = request.text.partition("=")
                raise ConfigError(
                    f"{request.text}: several values make several runs; add -m for them, or "
                    f"brackets if the setting is a list: {name}=[{value}]"
                )
            # An empty name would mix runs with the user's own files.
            if request.key in (RUN_FOLDER, "hydra.sweep.dir") and request.value in ("", None):
                raise ConfigError(
                    f"{request.key}: the name of a folder is allowed, or . for the working "
                    f"directory; the value is {request.value!r}"
                )
        self.check()

    def check(self) -> None:
        """Refuse requests that would be applied without the effect that they state."""
        for request in self.expanded:
            key, value = request.key, request.value
            if value == {} and not request.drops:
                drop = "~rewards drops every term" if key == "rewards" else f"~{key} drops it"
                raise ConfigError(
                    f"{request.text}: a mapping is merged into the existing one, so that "
                    f"an empty mapping changes nothing; {drop}"
                )
            # Names are allowed where entries of groups are chosen.
            is_choice = key in CHOICES or "/" in key or request.package is not None
            if not is_choice or isinstance(value, Several | Interval | dict) or request.drops:
                continue
            if not all(isinstance(v, str) for v in (value if isinstance(value, list) else [value])):
                raise ConfigError(f"{request.text}: a name is allowed; the value is {value!r}")

    def combinations(self) -> Iterator[Requests]:
        """Yield every combination of several values, without the intervals.

        Sweepers sample the intervals, and the jobs check the sampled values.
        """
        self.check()
        # Every value of every list; each combination is checked by itself.
        parts: list[tuple[Request, ...]] = []
        for request in self.expanded:
            if isinstance(request.value, Several):
                parts.append(request.value.requests)
                check_different(request.text, [part.value for part in parts[-1]])
            elif not isinstance(request.value, Interval):
                parts.append((request,))
        for combination in map(Requests, itertools.product(*parts)):
            combination.check()
            yield combination

    def interval_probes(self) -> Iterator[Requests]:
        """Yield the requests with each interval at its ends, and at a value between them."""
        for index, request in enumerate(self.items):
            if isinstance(request.value, Interval):
                for number in request.value.probes():
                    probe = replace(request, value=number, typed="")
                    yield Requests((*self.items[:index], probe, *self.items[index + 1 :]))


def _keys(key: str, value: object) -> Iterator[str]:
    """Yield a key, and the keys in a mapping that is its value."""
    yield key
    for name, inner in value.items() if isinstance(value, Mapping) else ():
        yield from _keys(f"{key}.{name}", inner)


def has_devices(robot: str | None) -> bool:
    """Return whether a robot is named by a file that has devices."""
    file = Path(robot) if robot is not None and is_robot_file(robot) else None
    return file is not None and file.is_file() and robot_devices(file) is not None


def _terms() -> frozenset[str]:
    """Return the reward terms of presets, which a request replaces, and never adds."""
    texts = (file.read_text("utf-8") for file in presets("rewards").values())
    return frozenset(name for text in texts for name in re.findall(r"- /reward@(\w+):", text))


def _expand(request: Request, paths: Collection[str]) -> Iterator[Request]:
    key, value = request.key, request.value
    if request.prefix or request.package or not isinstance(value, str):
        yield request
        return
    # A file of a robot or of a controller has settings; a term may be a new one.
    if key == "robot" and is_robot_file(value):
        if "," in value and not Path(value).exists():
            raise ConfigError(
                f"{request.text}: one file is allowed; lists name robots of the package: "
                f"{', '.join(presets('robot'))}"
            )
        settings = named_robot(value).model_dump(mode="json")
        section = key
    elif key == SECTION:
        settings, section = read_devices(Path(value)).perception(), "perception"
        if section not in paths:
            yield Request(section, "lidar")
    elif key in CONTROLLERS and policy_file.is_policy_file(value):
        settings = policy_file.settings_of(value, key)
        yield Request(key, settings.pop("name"))
        section = CONTROLLERS[key]
    else:
        term = key.removeprefix("rewards.")
        adds = key == f"rewards.{term}" and value in registered_names("reward")
        yield Request("reward", value, "+", key) if adds and term not in _terms() else request
        return
    for field, setting in settings.items():
        if (path := f"{section}.{field}") not in paths:
            yield Request(path, setting)


def from_values(settings: Mapping[str, object]) -> Iterator[Request]:
    """Yield the requests of Python values, as they are.

    Keys may be dotted. A mapping sets the fields below its key; the ``name`` in it, or a plugin's
    settings as an object, choose a plugin as well. Several names of a choice are several scenes. A
    reward term that is None is dropped, and an empty mapping of rewards drops all terms. The
    rewards of a controller are one setting: a preset's name, or all terms.

    Raises:
        ConfigError: a value cannot be a setting.
    """
    for key, value in settings.items():
        yield from _requests(key, _plain(value, key))


def _requests(key: str, value: Any) -> Iterator[Request]:
    prefix, path, package = _KEY.fullmatch(key).groups()  # type: ignore[union-attr]  # any text fits
    if (key == "rewards" and value == {}) or (_TERM.fullmatch(key) and value is None):
        yield Request(key, prefix="~")
    elif isinstance(value, dict) and value and not key.endswith("controller.rewards"):
        fields = dict(value)
        if key in CHOICES and "name" in fields:
            yield Request(key, fields.pop("name"))
        for name, inner in fields.items():
            yield from _requests(f"{key}.{name}", inner)
    elif key in CHOICES and key not in LISTS and isinstance(value, list) and value:
        if not all(isinstance(name, str) for name in value):
            raise ConfigError(f"{key}: names are allowed in a list; the value is {value!r}")
        yield Request(key, Several(tuple(Request(key, name) for name in value)))
    else:
        yield Request(path, value, prefix, package)


def _plain(value: object, key: str) -> Any:
    """Return plain data, without types of numpy, paths, tuples, enumerations and settings."""
    if isinstance(value, Settings):
        return to_dict(value, brief=True)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Enum):
        return _plain(value.value, key)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, range | tuple | list):
        return [_plain(item, key) for item in value]
    if isinstance(value, Mapping):
        return {str(name): _plain(item, f"{key}.{name}") for name, item in value.items()}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigError(
        f"{key}: {value!r} is no setting; numbers, texts, paths, None, lists, mappings and "
        "settings of plugins are allowed"
    )
