"""What is evaluated: policies that a user names, scenes of suites, and the plan that they make.

In: names of controllers, shipped policies, runs, files or folders of sweeps, and the name or file
of a suite, a list of scenes. Out: the policies' sources, methods with the policies that differ in
their training seeds, and a ``Plan``, which ``evaluate`` plays: which policies play which scenes,
and how they are called.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from flipperctl import checkpoint as checkpoints
from flipperctl.api import registry
from flipperctl.checkpoint.results import unfinished
from flipperctl.config import EvalConfig, strict_yaml
from flipperctl.config.policy_file import drives_in, is_policy_file
from flipperctl.config.presets import SUFFIX, presets, shipped
from flipperctl.config.words import check_different, check_words
from flipperctl.errors import ConfigError, FlipperctlError, RequestError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.policies.identity import method_settings, without_input_paths
from flipperctl.policies.source import ExportedPolicy, PolicySource, load_policy
from flipperctl.text.messages import broken_hint, close_match, unknown

BEST_KNOWN = "best known"
"""How a row of the best stored policy is called, before its label in brackets."""
_ALLOWED = (
    "about: TEXT and scenes: {NAME: OVERRIDES} are allowed, as in scenes: {low: sim.friction=0.6}"
)


def is_best_known(label: str) -> bool:
    """Return whether a row's label names the best stored policy."""
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
    """Number of the comparison of engines that the entry is a step of; None for none."""
    stored: str = ""
    """Label of the policy whose stored episodes of an earlier evaluation these are, else empty."""

    @property
    def terrain(self) -> str:
        """Name of the ground for people."""
        return self.config.terrain.title

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
        """Names besides the terrain and the policy's file, as far as there are any."""
        names: dict[str, Any] = {"suite_scene": self.scene or None, "method": self.method or None}
        names |= {"training_seed": self.training_seed}
        return {name: value for name, value in names.items() if value is not None}


@dataclass(frozen=True)
class Plan:
    """The entries of an evaluation, in the order in which they are played and shown."""

    entries: tuple[Entry, ...]
    title: str = ""
    """What is evaluated, as the user called it."""
    has_baselines: bool = False
    """Whether baselines and the best stored policy, if it is better than all, stand beside them."""

    @classmethod
    def of_one(
        cls, entries: Sequence[Entry], baselines: Sequence[PolicySource] = (), title: str = ""
    ) -> Plan:
        """Return the plan of one policy, whose other baselines play each scene after it."""
        planned: list[Entry] = []
        for entry in entries:
            planned.append(entry)
            for other in baselines:
                baseline = Entry(entry.config, other, is_baseline=True)
                if other != entry.source and baseline not in planned:
                    planned.append(baseline)
        return cls(tuple(planned), title)

    def config_of(self, source: PolicySource, entry: Entry) -> EvalConfig:
        """Return the settings with which a policy plays the episodes of an entry.

        An entry of its own on the same ground may have other settings than this one.
        """
        same = (e.config for e in self.entries if e.source == source and e.ground == entry.ground)
        return next(same, entry.config)

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


@dataclass(frozen=True)
class Suite:
    """Scenes that are evaluated together."""

    name: str
    about: str
    scenes: tuple[SuiteScene, ...]


def find_suite(name: str) -> Suite:
    """Return a suite by its name, or from a file."""
    known = presets("suite")
    file = known.get(name) or Path(name)
    if name not in known and not name.endswith((SUFFIX, ".yml")):
        raise ConfigError(
            f"suite: there is no suite {name!r}{close_match(name, known) or broken_hint()}; "
            f"known: {', '.join(known)}, or a file as in suite=mine.yaml"
        )
    where = f"suite {name if name in shipped('suite') else file}"
    document = strict_yaml.read(file, where)
    scenes = document.get("scenes") if isinstance(document, dict) else None
    if not isinstance(scenes, dict) or not scenes or not set(document) <= {"about", "scenes"}:
        raise ConfigError(f"{where}: {_ALLOWED}")
    parsed = tuple(_scene(where, scene, words) for scene, words in scenes.items())
    return Suite(Path(file.name).stem, str(document.get("about") or ""), parsed)


def _scene(where: str, name: str, overrides: object) -> SuiteScene:
    if not isinstance(overrides, str):
        raise ConfigError(f"{where}: scenes.{name}: {_ALLOWED}; the value is {overrides!r}")
    try:
        words = shlex.split(overrides)
        check_words(words)
    except (ValueError, ConfigError) as error:
        raise ConfigError(f"{where}: scenes.{name}: {error}") from error
    return SuiteScene(name, tuple(words))


def refuse_beside(option: str, others: Mapping[str, Any]) -> None:
    """Refuse options that have no meaning beside ``option``; ``others`` has their values."""
    for name, value in others.items():
        if value:
            name = name if name == "overrides" or "=" in name else f"--{name}"
            raise RequestError(f"{name}: no meaning beside {option}; leave it out")


RULES = ("level", "geometric")
"""Controllers that policies stand beside unless others are named: the smoothest of the rules."""


def controllers(
    names: str | None,
    option: str,
    default: Sequence[str] = (),
    planned: Sequence[PolicySource] = (),
) -> list[PolicySource]:
    """Return controllers at their ``reference_settings``; ``names`` are separated by commas.

    ``default`` is used if ``names`` is None; the name ``none`` stands for no controller.
    ``planned``: policies of an evaluation, which may be named as well.
    """
    return list(_controllers(names, option, default, planned).values())


def _controllers(
    names: str | None, option: str, default: Sequence[str], planned: Sequence[PolicySource] = ()
) -> dict[str, PolicySource]:
    listed = default if names is None else [] if names == "none" else names.split(",")
    baseline_names = [name.strip() for name in listed]
    if "none" in baseline_names:
        raise RequestError(f"{option}: none stands alone, without other names; got {names}")
    if not all(baseline_names):
        raise RequestError(f"{option}: names between commas, or none, are allowed; got {names!r}")
    check_different(option, baseline_names)

    def load(name: str) -> PolicySource:
        if planned and (source := load_policy(name, option)) in planned:
            return source
        return load_policy(name, option, "controller")

    return {name: load(name) for name in baseline_names}


def policies(
    names: Sequence[str], fields: Mapping[str, Any], tell: Callable[[str], None]
) -> dict[str, PolicySource]:
    """Return the policies of several names, each of which may join some by commas.

    Each of the ``fields`` applies to the controllers that have it. ``tell`` is called with a line
    if a run has no best policy yet.
    """
    labels = [part for text in names for part in split_names(text)]
    check_different("POLICY", labels)
    sources = {label: load_policy(label, "POLICY", tell=tell) for label in labels}
    for label, source in sources.items():
        settings = source.settings or {}
        if changes := {name: value for name, value in fields.items() if name in settings}:
            sources[label] = load_policy(label, "controller", fields={**settings, **changes})
    known = {name for s in sources.values() for name in s.settings or {} if name != "name"}
    for field in fields:
        if field not in known:
            what = f"controller.{field}: no controller among the policies has a field"
            raise ConfigError(unknown(what, field, sorted(known)))
    return sources


@dataclass(frozen=True)
class NamedPolicy:
    """A policy of an evaluation of several."""

    method: str
    """Name of the method; policies of equal methods differ in their training seeds."""
    run: Path | None = None
    """A run, a file or a shipped policy; None for a controller."""
    training_seed: int | None = None
    """Seed of the training, or number of the person; None for a controller."""
    settings: str = ""
    """Path that a controller's settings are from; empty: the method is a controller's name."""

    @property
    def controller(self) -> str:
        """The word that names the controller, if there is no ``run``."""
        return self.settings or self.method


def entrants(names: Sequence[str], tell: Callable[[str], None]) -> list[NamedPolicy]:
    """Return the policies of all methods, each once.

    A name means a controller or a shipped policy, or is the path of a run, a checkpoint or an
    exported file. Names of controllers may be joined by commas, and a path of such a name begins
    with ``./``. A folder with the runs of a sweep stands for them all: for one method, if they
    differ in their seeds alone. A folder with the drives of several people is one method, whose
    people count like seeds. ``tell`` is called with a line for each run that has no checkpoint,
    repeats another one, or is not finished.
    """
    policies: dict[NamedPolicy, None] = {}
    for name in (part for text in names for part in split_names(text)):
        if ("controller", name) in registry or is_policy_file(name):
            policies[NamedPolicy(name)] = None
        else:
            policies |= dict.fromkeys(_of_path(Path(name), tell))
    return list(policies)


def split_names(text: str) -> list[str]:
    """Return the names that commas join; a path may have commas of its own."""
    if _exists(text) or "," not in text:
        return [text]
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise RequestError(f"names between commas are allowed, as in geometric,level; got {text!r}")
    return names


def split_policies(words: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """Return the policies among the words of a command, and the overrides."""
    policies: list[str] = []
    overrides: list[str] = []
    for word in words or ():
        plain = "=" not in word and not word.startswith(("~", "+"))
        (policies if plain or _exists(word) else overrides).append(word)
    return policies, overrides


def _exists(name: str) -> bool:
    return os.path.exists(name)  # noqa: PTH110  # false for any text, however long


def standing(baseline: str | None, present: Sequence[NamedPolicy]) -> list[NamedPolicy]:
    """Return the controllers beside the methods; ``baseline`` names others, or none."""
    names = _controllers(baseline, "--baseline", RULES)
    return [e for e in map(NamedPolicy, names) if e not in present]


def _of_path(path: Path, tell: Callable[[str], None]) -> Iterator[NamedPolicy]:
    # False for any text, however long.
    if people := drives_in(path):
        for number, folder in enumerate(people):
            _, plus, helper = folder.name.partition("+")
            yield NamedPolicy(f"{path}{plus}{helper}", None, number, str(folder))
        return
    sweep = os.path.isdir(path) and not checkpoints.holds(path)  # noqa: PTH112
    if not sweep or not checkpoints.runs_in(path):
        yield NamedPolicy(str(path), path, _trained(load_policy(path))[0])
        return
    # Runs that can be read; equal trainings count once.
    trained: list[tuple[Path, int | None, dict[str, Any]]] = []
    for run in sorted((f for f in path.iterdir() if f.is_dir()), key=checkpoints.job_order):
        if not (run / "config.yaml").exists() and not checkpoints.holds(run):
            continue  # no run at all
        try:
            seed, settings = _trained(load_policy(run, takes="file"))
        except FlipperctlError as error:
            tell(f"{run} is left out: {error}")
            continue
        equal = [other for other, *identity in trained if identity == [seed, settings]]
        if equal:
            tell(f"{run} is left out: {equal[0]} has its seed and what it learns by")
            continue
        if unfinished(run):
            tell(f"{run} is not trained to its end; it counts like the others")
        trained.append((run, seed, settings))
    if not trained:
        raise RequestError(f"{path}: no run of this sweep has a checkpoint that can be read")
    # Seeds that each went on from a run of their own are one method; runs of one seed that went on
    # from several runs are several.
    groups: dict[str, list[tuple[Path, int | None]]] = {}
    keys = [(repr(without_input_paths(settings)), seed) for _, seed, settings in trained]
    for (alike, _), (run, seed, settings) in zip(keys, trained, strict=True):
        repeated = any(keys.count(key) > 1 for key in keys if key[0] == alike)
        groups.setdefault(repr(settings) if repeated else alike, []).append((run, seed))
    # The swept values name a method, if they tell it from the others.
    swept = [_swept(members[0][0]) for members in groups.values()]
    for members, values in zip(groups.values(), swept, strict=True):
        telling = values and swept.count(values) == 1
        name = f"{path}/{values}" if telling else str(members[0][0])
        for run, seed in members:
            yield NamedPolicy(str(path) if len(groups) == 1 else name, run, seed)


def _swept(run: Path) -> str:
    """Return the swept values in the name of a run but for its seed, as in ``network=conv``."""
    values: list[str] = []
    for part in run.name.partition("_")[2].split(","):
        if "=" in part or not values:
            values.append(part)
        else:  # of a list, as in network.hidden=_64,32_
            values[-1] += f",{part}"
    return ",".join(value for value in values if "=" in value and not value.startswith("seed="))


def _trained(source: PolicySource) -> tuple[int | None, dict[str, Any]]:
    """Return the seed of a training, and the settings that name its method."""
    if source.is_exported:
        return ExportedPolicy(source.file).interface.seed, {"file": str(source.file)}
    config = checkpoints.read_policy(source.file).policy_config()
    return config.seed, method_settings(config)
