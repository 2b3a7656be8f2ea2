"""What can be looked up: names by kind, settings by key, words of the field, and a search over all.

In: the registry, the sections' classes, the presets and policies of the package, folders of runs.
Out: plain values.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

from flipperctl.api import Learner, Robot, Settings, registry
from flipperctl.api.plugin import broken
from flipperctl.checkpoint import shipped_policies
from flipperctl.checkpoint.results import CONFIG, holds_run, read_config, summary_of
from flipperctl.cli.glossary import GLOSSARY
from flipperctl.config import (
    Episode,
    Eval,
    LocalCollector,
    Randomise,
    RayCollector,
    Teacher,
    Train,
    TrainConfig,
    strict_yaml,
)
from flipperctl.config.describe import Field, fields, summary
from flipperctl.config.presets import presets as files
from flipperctl.config.words import key_of, override_text
from flipperctl.errors import RequestError
from flipperctl.plugging import plugins
from flipperctl.training.search import SearchSettings
from flipperctl.training.sweep import of_reached

SECTIONS: Mapping[str, type[Settings]] = {
    "train": Train,
    "eval": Eval,
    "robot": Robot,
    "episode": Episode,
    "randomise": Randomise,
    "teacher": Teacher,
    "collector=local": LocalCollector,
    "collector=ray": RayCollector,
    "hydra.sweeper": SearchSettings,
}
"""Class of each section whose settings do not depend on a plugin."""

PLUGIN_KEYS: Mapping[str, str] = {
    **{kind: kind for kind in ("terrain", "network", "agent", "controller", "sim", "perception")},
    "reward": "rewards.NAME",
    "logger": "logger.NAME",
}
"""Kind of plugin → key of its settings."""


_FURTHER = {
    "conditions": {"trained": "Those of the policy's training, which its checkpoint holds"},
    "measure": {
        "outcomes": "How many episodes ended as reached, overturned, stuck and timeout",
        "return": "Sum of the rewards of an episode",
        "success_rate": "Share of the episodes that reached the finish",
    },
}
"""Names that are in no file and of no plugin, by group."""


class Group(NamedTuple):
    """How a plugin, a preset or a policy is used."""

    command: str
    """A command with NAME in its place."""
    example: str


KINDS: Mapping[str, Mapping[str, Group]] = {
    "terrains": {"terrain": Group("flipperctl train terrain=NAME", "stair")},
    "rewards": {
        "rewards": Group("flipperctl train rewards=NAME", "tuned"),
        "reward": Group("flipperctl train rewards.NAME=NAME", "impact"),
    },
    "learners": {"agent": Group("flipperctl train agent=NAME", "policy_gradient")},
    "networks": {"network": Group("flipperctl train network=NAME", "conv")},
    "controllers": {"controller": Group("flipperctl eval NAME terrain=stair", "level")},
    "policies": {"policy": Group("flipperctl eval NAME terrain=stair", "generalist")},
    "measures": {"measure": Group("flipperctl eval okada --columns NAME", "max_pitch")},
    "experiments": {"experiment": Group("flipperctl train experiment=NAME", "quick")},
    "suites": {"suite": Group("flipperctl eval generalist suite=NAME", "robustness")},
    "conditions": {"conditions": Group("flipperctl eval generalist conditions=NAME", "wide")},
    "robots": {"robot": Group("flipperctl train robot=NAME", "absolem")},
    "engines": {"sim": Group("flipperctl eval okada sim=NAME", "mujoco")},
    "sensors": {"perception": Group("flipperctl eval okada perception=NAME", "lidar")},
    "teachers": {"teacher": Group("flipperctl train teacher=NAME", "lookahead")},
    "loggers": {"logger": Group("flipperctl train logger=NAME", "wandb")},
    "plugins": {"plugin": Group("flipperctl inspect plugins NAME", "flipperctl")},
    "runs": {"run": Group("flipperctl eval NAME", "runs/first")},
}
"""Kind of names → groups of them."""


def _groups() -> dict[str, Group]:
    return {name: group for groups in KINDS.values() for name, group in groups.items()}


@dataclass(frozen=True)
class Entry:
    """A name that a command or a setting takes."""

    group: str
    name: str
    summary: str
    """One sentence."""
    about: str = ""
    """The whole text about a preset; empty for others."""
    settings: Mapping[str, str] = field(default_factory=dict)
    """Settings of a preset by key; a suite's overrides by the names of its scenes."""

    @property
    def command(self) -> str:
        """A command that uses it."""
        return _groups()[self.group].command.replace("NAME", self.name)


@dataclass(frozen=True)
class Key:
    """A setting that can be overridden."""

    key: str
    owner: str
    """The section, or kind and name of the plugin, that it belongs to."""
    cls: type[Settings]
    field: Field

    @property
    def alias(self) -> str:
        """What tells it from equal keys of other plugins, as ``stair.rise`` for terrain.rise."""
        return f"{self.owner.rpartition(' ')[2]}.{self.field.name}"

    def command(self, *, used: bool) -> str:
        """Return a command that sets it to its default; ``used``: by train as it is."""
        kind, _, name = self.owner.partition(" ")
        word = f"{self.key}={override_text(self.field.default)}"
        # A choice of plugin is set by a command that chooses one.
        if kind == "training" and self.key in (groups := _groups()):
            return groups[self.key].command.replace("NAME", groups[self.key].example)
        # A setting of a plugin needs its plugin chosen, unless train has it anyway.
        if "=" in kind:
            word = f"{self.owner} {word}"
        elif kind == "controller":
            return f"flipperctl eval {name} {word}"
        elif name and not used:
            word = f"{self.key.rpartition('.')[0]}={name} {word}"
        return f"flipperctl {'eval okada' if kind == 'eval' else 'train'} {word}"


def entries(group: str) -> list[Entry]:
    """Return the names of a group, sorted."""
    # Policies and packages have texts of their own; plugins and presets are in registry and files.
    if group == "policy":
        return [Entry(group, name, _of_card(file)) for name, file in shipped_policies().items()]
    if group == "plugin":
        inside = {
            package: shorten(f"{len(keys)}: {', '.join(map(' '.join, keys))}", 72, placeholder=" …")
            for package, keys in plugins.packages().items()
        }
        inside |= {package.package: f"broken: {package.reason}" for package in broken}
        return [Entry(group, name, text) for name, text in sorted(inside.items())]
    further = [Entry(group, name, text) for name, text in _FURTHER.get(group, {}).items()]
    if any(kind == group for kind, _ in registry):
        classes = [(name, cls) for (kind, name), cls in sorted(registry.items()) if kind == group]
        return [Entry(group, name, summary(cls).rstrip(".")) for name, cls in classes] + further
    return [preset(group, name, file) for name, file in files(group).items()] + further


def presets() -> Iterator[Entry]:
    """Yield every named set of settings."""
    for group in ("experiment", "rewards", "conditions", "robot", "teacher", "suite"):
        yield from entries(group)


def preset(group: str, name: str, file: Any) -> Entry:
    """Return a named set of settings; its first comment, or a suite's ``about``, is about it."""
    text = strict_yaml.read_text(file, file.name)
    document = _parsed(text, file.name)
    # The first comment of a preset says what it is for.
    first = re.match(r"(?:# @package .*\n)?((?:#.*\n)*)", text)
    comment = " ".join(line.lstrip("# ") for line in (first[1] if first else "").splitlines())
    if group == "suite":
        about, settings = str(document.get("about", "")), dict(document.get("scenes", {}))
    else:
        about = " ".join(comment.split())
        prefix = "" if group in ("experiment", "conditions") else f"{group}."
        settings = dict(_flat(document, prefix))
        if group == "experiment":  # and what it sets of single learners
            for part, inner in files("by_learner").items():
                if part.startswith(f"{name}-"):
                    inside = _parsed(strict_yaml.read_text(inner, part), part)
                    settings |= _flat(inside, f"{Learner.kind}.")
    return Entry(group, name, first_sentence(about), about, settings)


@cache
def _parsed(text: str, where: str) -> Any:
    """Return the data of a preset, to be read alone; a command may ask for it several times."""
    return strict_yaml.parse(text, where) or {}


def first_sentence(text: str) -> str:
    """Return a text up to the end of its first sentence."""
    return re.split(r"\.\s(?=[A-Z`(])", text, maxsplit=1)[0].rstrip(".")


def first_clause(text: str) -> str:
    """Return a text up to its first semicolon."""
    return text.partition(";")[0]


def keys() -> Iterator[Key]:
    """Yield every setting of every section and plugin, and the settings outside of sections."""
    # Choices of the configuration itself, such as network or collector
    for setting in fields(TrainConfig):
        choices = [e.name for e in entries(setting.name)]
        choices += [
            word[2] for name in SECTIONS if (word := name.partition("="))[0] == setting.name
        ]
        if setting.description:
            allowed = setting.bounds or ", ".join(filter(None, choices))
            yield Key(setting.name, "training", TrainConfig, replace(setting, bounds=allowed))
    # Sections without a plugin, then every plugin
    for name, cls in SECTIONS.items():
        path, _, choice = name.partition("=")
        section_fields = (f for f in fields(cls) if not (choice and f.name == "name"))
        yield from (Key(f"{path}.{f.name}", name, cls, f) for f in section_fields)
    for (kind, name), plugin in sorted(registry.items()):
        path = PLUGIN_KEYS.get(kind, "").replace("NAME", name)
        for setting in fields(plugin) if path else ():
            yield Key(f"{path}.{setting.name}", f"{kind} {name}", plugin, setting)


def _arguments() -> Iterator[Key]:
    """Yield the keys within mappings of learners, as the learners describe them.

    Raises:
        MissingExtraError: what a learner needs is not installed.
    """
    for (kind, _), plugin in sorted(registry.items()):
        if kind == Learner.kind and issubclass(plugin, Learner):
            for owner, field in plugin.arguments():
                yield Key(f"{kind}.{field.name}", owner, plugin, field)


def keys_named(word: str) -> list[Key]:
    # A whole key first, then a section; a field's name alone may be that of many.
    """Return the settings that a word names: by key, by section, by ``stair.rise`` or ``rise``."""
    known = list(keys())
    whole = [key for key in known if key.key == word]
    if not whole and word.startswith("randomise."):  # the range of another setting
        whole = [key for key in known if key.key == word.removeprefix("randomise.")]
    if not whole and word.count(".") > 1 and word.startswith(f"{Learner.kind}."):
        known = list(_arguments())
        whole = [key for key in known if key.key == word]
    whole += [key for key in known if key.owner.partition("=")[0] == word]
    if whole:
        return whole
    return [key for key in known if word in (key.field.name, key.alias)]


def set_by(key: Key) -> dict[str, str]:
    """Return the presets that set a setting, each with its value."""
    section, _, plugin = key.owner.partition(" ")
    return {
        f"{entry.group}={entry.name}": entry.settings[key.key]
        for entry in presets()
        if key.key in entry.settings and entry.settings.get(section, plugin) == plugin
    } | {
        f"suite={entry.name}": "some scenes"
        for entry in entries("suite")
        if any(key_of(word) == key.key for s in entry.settings.values() for word in s.split())
    }


@dataclass(frozen=True)
class Hit:
    """Something that a search found."""

    name: str
    kind: str
    summary: str


def search(words: str, commands: Mapping[str, str], most: int = 10) -> list[Hit]:
    """Return what fits words best, names before descriptions; ``commands``: help by name."""
    tokens = re.findall(r"[^\W_]+", words.lower())
    needed = 1 if " " in words else len(tokens)  # agent.gama is a misspelling
    scored = []
    for hit in _everything(commands):
        # Whole words of a name weigh more than their beginnings, and these more than the
        # description.
        name, text = re.findall(r"[^\W_]+", hit.name.lower()), hit.summary.lower()
        each = [
            8 if t in name
            else max(4 * any(part.startswith(t) for part in name), 2 * (f" {t}" in f" {text}"))
            for t in tokens
        ]  # fmt: skip
        if sum(map(bool, each)) >= needed:
            scored.append((sum(map(bool, each)), sum(each), -len(name), hit))
    scored.sort(key=lambda scored_hit: scored_hit[:3], reverse=True)
    hits = {(hit.name, hit.kind): hit for *_, hit in reversed(scored)}.values()
    return [replace(hit, summary=_short(hit)) for hit in [*hits][::-1][:most]]


def _short(hit: Hit) -> str:
    """Return the text about a hit; of a command, its help's first sentence."""
    return first_sentence(hit.summary.split("\n\n")[0]) if hit.kind == "command" else hit.summary


def _everything(commands: Mapping[str, str]) -> Iterator[Hit]:
    for word, text in GLOSSARY.items():
        yield Hit(word, "word", text)
    for groups in KINDS.values():
        for group in groups:
            yield from (Hit(e.name, group, e.summary) for e in entries(group))
    for name, text in commands.items():
        yield Hit(name, "command", text)
    for key in keys():
        yield Hit(key.key, "setting", first_clause(key.field.description))


def names() -> Iterator[str]:
    """Yield everything that can be explained, for close matches."""
    for hit in _everything({}):
        yield hit.name
    yield from (key.field.name for key in keys())


def runs(folder: Path) -> list[dict[str, Any]]:
    """Return the training runs below a folder, the newest first."""
    if not folder.is_dir():
        raise RequestError(f"{folder}: there is no such folder; runs are in runs/ by default")
    rows = [_run(Path(place)) for place in _run_folders(folder)]
    return sorted(rows, key=lambda row: str(row["date"]), reverse=True)


def _run_folders(folder: Path) -> Iterator[str]:
    for place, inner, _ in os.walk(folder):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        if holds_run(Path(place)):
            inner.clear()
            yield place


def _run(folder: Path) -> dict[str, Any]:
    """Return what a run trained and how its best validation was."""
    # A run that was killed has no summary, but a configuration.
    config, _ = read_config(folder / CONFIG)
    plain: dict[str, Any] = config if isinstance(config, dict) else {}
    document = summary_of(folder)
    best = of_reached(document.get("best") or {})
    changed = max(file.stat().st_mtime for file in (folder, *folder.glob("*.*")))
    return {
        "name": str(folder),
        "terrain": (plain.get("terrain") or {}).get("name"),
        "decisions": document.get("decisions"),
        "success_rate": best.get("success_rate"),
        "pitch_variation_100hz": best.get("pitch_variation_100hz"),
        "date": datetime.fromtimestamp(changed).strftime("%Y-%m-%d %H:%M"),
    }


def _of_card(policy: Path) -> str:
    """Return the first sentence of the card beside a policy."""
    card = policy.with_suffix(".md")
    text = card.read_text("utf-8") if card.is_file() else ""
    paragraphs = [part for part in text.split("\n\n") if part[:1] not in ("#", "")]
    return first_sentence(" ".join(paragraphs[0].split())) if paragraphs else ""


def _flat(node: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    """Yield the settings of a preset's file, and the choices in its list of defaults."""
    for key, value in node.items():
        if key == "defaults":
            yield from _choices(value, prefix)
        elif isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", override_text(value)


def _choices(defaults: Iterable[Any], prefix: str) -> Iterator[tuple[str, str]]:
    for choice in defaults:
        if isinstance(choice, str):
            if choice != "_self_":
                yield "begins with", choice
            continue
        for key, value in choice.items():
            group = key.removeprefix("override ").lstrip("/").rpartition("@")[2]
            yield (group if "override" in key or "@rewards" in key else prefix + group), value
