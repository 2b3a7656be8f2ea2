"""Suites: named lists of scenes, on which any method is evaluated with one command.

In: a name, or a file in YAML. Out: the suite's scenes, each with the overrides that make it.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from flipperctl import plugins
from flipperctl.config import strict_yaml
from flipperctl.config.words import check_words, key_of
from flipperctl.errors import ConfigError
from flipperctl.messages import close_match

_SUFFIX = ".yaml"
_ALLOWED = (
    "about: TEXT and scenes: {NAME: OVERRIDES} are allowed, as in scenes: {low: sim.friction=0.6}"
)


@dataclass(frozen=True)
class SuiteScene:
    """A scene of a suite, or several, if its overrides have lists."""

    name: str
    words: tuple[str, ...]
    """Overrides, ``key=value``."""

    def name_with(self, words: list[str]) -> str:
        """Return the name, with those of the user's ``words`` that replace one of the scene's.

        Tables name the terrain by themselves.
        """
        own = {key_of(word): word for word in self.words if key_of(word) != "terrain"}
        changed = [word for word in words if own.get(key_of(word), word) != word]
        return " ".join([f"{self.name},", *changed]) if changed else self.name

    def with_words(self, words: list[str]) -> list[str]:
        """Return the overrides, of which the user's ``words`` replace those of the same keys."""
        typed = {key_of(word) for word in words}
        return [*(word for word in self.words if key_of(word) not in typed), *words]


@dataclass(frozen=True)
class Suite:
    """Scenes that are evaluated together."""

    name: str
    about: str
    scenes: tuple[SuiteScene, ...]


def shipped_suites() -> dict[str, Traversable]:
    """Return the files of the suites that come with flipperctl, by name."""
    found = sorted(files("flipperctl.configs.suite").iterdir(), key=lambda file: file.name)
    return {f.name.removesuffix(_SUFFIX): f for f in found if f.name.endswith(_SUFFIX)}


def _plugin_suites() -> dict[str, Path]:
    """Return the suites of plugins by name: the files in ``suite`` beside each plugin."""
    found: dict[str, Path] = {}
    for folder in plugins.folders():
        for file in sorted((folder / "suite").glob(f"*{_SUFFIX}")):
            other = found.setdefault(file.stem, file)
            if file.stem in shipped_suites():
                raise ConfigError(f"suite: {file} has the name of a suite of flipperctl; rename it")
            if other != file:
                raise ConfigError(f"suite: {other} and {file} have the same name; rename one")
    return found


def find_suite(name: str) -> Suite:
    """Return a suite by its name, or from a file."""
    shipped, others = shipped_suites(), _plugin_suites()
    file: Traversable = shipped.get(name) or others.get(name) or Path(name)
    if name not in shipped | others and not name.endswith((_SUFFIX, ".yml")):
        known = [*shipped, *others]
        raise ConfigError(
            f"suite: there is no suite {name!r}{close_match(name, known)}; known: "
            f"{', '.join(known)}, or a file as in suite=mine.yaml"
        )
    where = f"suite {name if name in shipped else file}"
    document = strict_yaml.read(file, where)
    scenes = document.get("scenes") if isinstance(document, dict) else None
    if not isinstance(scenes, dict) or not scenes or not set(document) <= {"about", "scenes"}:
        raise ConfigError(f"{where}: {_ALLOWED}")
    made = tuple(_scene(where, scene, words) for scene, words in scenes.items())
    return Suite(Path(file.name).stem, str(document.get("about") or ""), made)


def _scene(where: str, name: str, overrides: object) -> SuiteScene:
    if not isinstance(overrides, str):
        raise ConfigError(f"{where}: scenes.{name}: {_ALLOWED}; the value is {overrides!r}")
    try:
        words = shlex.split(overrides)
        check_words(words)
    except (ValueError, ConfigError) as error:
        raise ConfigError(f"{where}: scenes.{name}: {error}") from error
    return SuiteScene(name, tuple(words))


def split_suite(words: list[str]) -> tuple[Suite | None, list[str]]:
    """Return the suite that ``suite=NAME`` among the words chooses, and the other words.

    Raises:
        ConfigError: there is no such suite, or several are given.
    """
    chosen = [word for word in words if key_of(word) == "suite" and "=" in word]
    if len(chosen) > 1:
        raise ConfigError(f"suite is given twice: {chosen[0]} and {chosen[1]}; one is allowed")
    suite = find_suite(chosen[0].partition("=")[2]) if chosen else None
    return suite, [word for word in words if word not in chosen]
