"""The plan of an evaluation: which policies play which scenes, and how they are called.

In: a configuration and a policy's source for each entry; the name or file of a suite, a list of
scenes on which any method is evaluated. Out: a ``Plan``, which ``evaluate`` plays.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from flipperctl import plugins
from flipperctl.config import EvalConfig, strict_yaml
from flipperctl.config.words import check_words, key_of
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.messages import close_match
from flipperctl.policies.source import PolicySource

BEST_KNOWN = "best known"
"""How a row of the best stored policy is called, before its label in brackets."""
_SUFFIX = ".yaml"
_ALLOWED = (
    "about: TEXT and scenes: {NAME: OVERRIDES} are allowed, as in scenes: {low: sim.friction=0.6}"
)


def is_best_known(label: str) -> bool:
    """Return whether a row's label is that of the best stored policy."""
    return label.startswith(f"{BEST_KNOWN} (")


@dataclass(frozen=True)
class Entry:
    """One policy on one scene."""

    config: EvalConfig
    """``config.eval`` holds the number of episodes and the seed."""
    source: PolicySource
    scene: str = ""
    """Name of the scene within its suite."""
    method: str = ""
    """Name of the method, whose policies differ in their training seeds; empty for one policy."""
    training_seed: int | None = None
    """Seed of the policy's training; None for a controller, or if there is one seed alone."""
    is_baseline: bool = False
    """Whether the policy plays for comparison alone."""
    comparison: int | None = None
    """Number of the comparison of engines of which the entry is a step; None for none."""
    stored: str = ""
    """Label of the policy whose stored episodes of an earlier evaluation these are, else empty."""

    @property
    def terrain(self) -> str:
        """Name of the terrain plugin."""
        return self.config.terrain.plugin_name

    @property
    def sim(self) -> str:
        """Name of the engine."""
        return self.config.sim.plugin_name

    @property
    def label(self) -> str:
        """Label of the policy: a shipped policy's or a controller's name, else a path."""
        return self.stored or self.source.label()

    @property
    def row_label(self) -> str:
        """Label of the policy in files; a row of stored episodes says so."""
        return self.named if self.stored else self.label

    @property
    def named(self) -> str:
        """Name of the policy for tables: its method with the training seed, else its label."""
        seed = "" if self.training_seed is None else f", seed {self.training_seed}"
        return f"{self.method}{seed}" if self.method else self.label

    @cached_property
    def conditions(self) -> Conditions:
        """The settings that determine how the episodes are sampled and simulated."""
        return Conditions.of(self.config)

    @property
    def ground(self) -> tuple[str, str, int, int]:
        """What is equal for the entries that play equal episodes."""
        numbers = self.config.eval
        return self.scene, self.conditions.hash, numbers.seed, numbers.episodes

    @property
    def names(self) -> dict[str, Any]:
        """Names beyond those of the terrain and of the policy's file, as far as there are any."""
        names: dict[str, Any] = {"suite_scene": self.scene or None, "method": self.method or None}
        names |= {"training_seed": self.training_seed}
        return {name: value for name, value in names.items() if value is not None}


@dataclass(frozen=True)
class Plan:
    """The entries of an evaluation, in the order in which they are played and shown."""

    entries: tuple[Entry, ...]
    title: str = ""
    """What is evaluated, as the user called it."""
    with_best_known: bool = False
    """Whether a row of the best stored policy stands beside them, where it is better than all."""

    @classmethod
    def of_one(
        cls, entries: Sequence[Entry], baselines: Sequence[PolicySource] = (), title: str = ""
    ) -> Plan:
        """Return the plan of one policy, whose other baselines play each scene after it."""
        found: list[Entry] = []
        for entry in entries:
            found.append(entry)
            for other in baselines:
                beside = Entry(entry.config, other, is_baseline=True)
                if other != entry.source and beside not in found:
                    found.append(beside)
        return cls(tuple(found), title)

    @property
    def engines(self) -> bool:
        """Whether engines are compared."""
        return any(entry.comparison is not None for entry in self.entries)

    @property
    def has_methods(self) -> bool:
        """Whether it is a plan of several methods, or of a suite, whose baselines have rows."""
        return any(entry.method for entry in self.entries)

    @property
    def rows(self) -> list[Entry]:
        """The entries that are scenes of the result; baselines are so beside several methods."""
        return [e for e in self.entries if self.has_methods or not e.is_baseline]


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
    """Return the suite that ``suite=NAME`` among the words chooses, and the other words."""
    chosen = [word for word in words if key_of(word) == "suite" and "=" in word]
    if len(chosen) > 1:
        raise ConfigError(f"suite is given twice: {chosen[0]} and {chosen[1]}; one is allowed")
    suite = find_suite(chosen[0].partition("=")[2]) if chosen else None
    return suite, [word for word in words if word not in chosen]
