"""The text of the reference pages, generated from the code when the pages are built.

In: the configuration's classes, the plugin registry, the command line and the public modules. Out:
Markdown. ``fill`` replaces a line ``<!-- generate: NAME -->`` of a page by the text ``NAME``, and
``<!-- generate: settings: HEADING -->`` by the settings below one heading. ``plugins: KIND`` is a
table of plugins.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from itertools import groupby
from pathlib import Path
from typing import Any, cast, get_origin

import typer.main
from gymnasium.spaces import Box
from sphinx.pycode import ModuleAnalyzer

from flipperctl.api import ACTIONS, ObservationLayout, Settings, registry
from flipperctl.cli.catalogue import PLUGIN_KEYS, SECTIONS
from flipperctl.cli.glossary import GLOSSARY
from flipperctl.cli.main import app
from flipperctl.config import EvalConfig
from flipperctl.config.describe import Field, fields
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.export.metadata import describe_observation
from flipperctl.plugging import plugins
from flipperctl.requests import compose
from flipperctl.text.elsewhere import WORDS, Foreign

HEADINGS: Mapping[str, str] = {
    "terrain": "Terrains",
    "reward": "Reward terms",
    "network": "Networks",
    "agent": "Learners",
    "controller": "Controllers",
    "sim": "Engines",
    "perception": "Sensors",
    "measure": "Measures",
    "logger": "Loggers",
}
"""Heading of each kind of plugin."""

MODULES = ("flipperctl", "flipperctl.api", "flipperctl.runtime", "flipperctl.testing")
"""Public modules; each lists its names in ``__all__``."""

_MARK = re.compile(r"^<!-- generate: (\w+)(?:: (.+))? -->$", re.MULTILINE)


def fill(text: str) -> str:
    """Replace each line that asks for a text by that text."""
    return _MARK.sub(lambda mark: TEXTS[mark[1]](*filter(None, [mark[2]])), text)


def settings(part: str = "") -> str:
    """Return a table of every setting of each section and of each plugin's class.

    With the heading of a part, return what is below it, with its own headings one level higher.
    """
    plugins.load()
    lines = ["## Top level", *_table("", _top_level())]
    for name, cls in SECTIONS.items():
        path = name.partition("=")[0]
        lines += ["", f"## `{name}`", "", _summary(cls), ""]
        lines += _table(path, (f for f in fields(cls) if f.name != "name"))
    for kind, heading in HEADINGS.items():
        path = PLUGIN_KEYS.get(kind, kind).replace(
            "NAME", f"<{'term' if kind == 'reward' else kind}>"
        )
        lines += ["", f"## {heading}", ""]
        for name in sorted(name for of, name in registry if of == kind):
            cls = registry[kind, name]
            lines += ["", f"### `{path.partition('.')[0]}`: `{name}`", "", _summary(cls), ""]
            lines += _table(path, fields(cls))
    text = "\n".join(lines)
    if part:
        parts = re.split(r"^## (.+)\n", text, flags=re.MULTILINE)
        text = dict(zip(parts[1::2], parts[2::2], strict=True))[part].replace("### ", "## ")
    return text


def commands() -> str:
    """Return every command with its arguments and options."""
    group = typer.main.get_command(app)
    return "\n".join(
        line for path, command in _subcommands(group) for line in _command(path, command)
    )


def api() -> str:
    """Return an entry for each name of the public modules and for the environment."""
    parts = []
    for module in MODULES:
        found = importlib.import_module(module)
        parts += [f"## `{module}`", "", _roles(inspect.getdoc(found) or ""), "", "```{eval-rst}"]
        for name in found.__all__:
            parts += [*_entry(module, name, getattr(found, name)), ""]
        parts += ["```", ""]
    environment = "flipperctl.env.flipper_env.FlipperEnv"
    parts += ["## The Gymnasium environment", "", "```{eval-rst}", f".. autoclass:: {environment}"]
    parts += ["   :members:", "```"]
    return "\n".join(parts)


def presets() -> str:
    """Return the named sets of settings as their files have them."""
    folder = Path(__file__).parents[1] / "configs"
    parts = []
    for group in sorted({file.parent for file in folder.glob("*/*.yaml")}):
        parts += [f"## {group.name.capitalize()}", ""]
        for file in sorted(group.glob("*.yaml")):
            text = file.read_text(encoding="utf-8").strip()
            parts += [f"### `{group.name}={file.stem}`", "", "```yaml", text, "```", ""]
    return "\n".join(parts)


def actions() -> str:
    """Return a table of the actions."""
    words = {-1: "down", 0: "hold", 1: "up"}
    rows = [(index, *map(words.get, pairs)) for index, pairs in enumerate(ACTIONS)]
    return "\n".join(_rows(("action", "front flippers", "rear flippers"), rows))


def observation() -> str:
    """Return a table of the default observation; numbers of one meaning are one row."""
    plugins.load()
    space = cast("Box", FlipperEnv().observation_space)
    rows: list[tuple[object, ...]] = []
    described = enumerate(describe_observation(ObservationLayout()))
    for _, group in groupby(described, lambda one: re.sub(r"_\d+$", "", one[1]["name"])):
        (first, start), *rest = group
        last, end = rest[-1] if rest else (first, start)
        spans = ((first, last), (f"`{start['name']}`", f"`{end['name']}`"))
        ends = (" … ".join(dict.fromkeys(map(str, span))) for span in spans)
        meaning, bounds = start["meaning"].partition(", for x in")[0], (space.low, space.high)
        limits = (f"{bound[first]:.4g}" for bound in bounds)
        rows.append((*ends, meaning, start["unit"], start["frame"], *limits))
    return "\n".join(_rows(("index", "name", "meaning", "unit", "frame", "min", "max"), rows))


def summaries(kind: str) -> str:
    """Return a table of the plugins of a kind, each with what it does."""
    plugins.load()
    classes = sorted((name, cls) for (of, name), cls in registry.items() if of == kind)
    return "\n".join(
        _rows((kind, "meaning"), ((f"`{name}`", _summary(cls)) for name, cls in classes))
    )


def _rows(heads: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    heads = list(heads)
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    return lines + [f"| {' | '.join(map(_cell, row))} |" for row in rows]


def glossary() -> str:
    """Return a table of the words that ``flipperctl explain`` knows."""
    return "\n".join(_rows(("word", "meaning"), GLOSSARY.items()))


def elsewhere() -> str:
    """Return a table of the words of other tools, with what is typed here."""
    alike: dict[Foreign, list[str]] = {}
    for word, foreign in WORDS.items():
        alike.setdefault(foreign, []).append(word)
    rows = (
        (", ".join(words), foreign.meaning, " or ".join(f"`{text}`" for text in foreign.ours))
        for foreign, words in alike.items()
    )
    return "\n".join(_rows(("there", "meaning", "here"), rows))


TEXTS: Mapping[str, Callable[..., str]] = {
    "glossary": glossary,
    "elsewhere": elsewhere,
    "settings": settings,
    "commands": commands,
    "api": api,
    "presets": presets,
    "actions": actions,
    "observation": observation,
    "plugins": summaries,
}
"""Texts that pages can ask for."""


def _top_level() -> Iterator[Field]:
    """Yield the keys that name a plugin or a variant, and those outside of all sections."""
    from flipperctl.config.describe import settings as all_settings

    compose.register_defaults()
    (config,) = compose.compose_train()
    for setting in all_settings(config):
        f = setting.field
        if setting.path == setting.section or not setting.section:
            yield Field(setting.path, f.type, setting.value, f.bounds, f.unit, f.description)
    yield from (f for f in fields(EvalConfig) if f.name == "conditions")


def _table(path: str, found: Iterable[Field]) -> list[str]:
    rows = [
        (
            f"`{path}.{f.name}`" if path else f"`{f.name}`",
            f.description,
            _value(f.default),
            # A bound of the machine's integers says nothing, and a number may have no unit.
            f"{re.sub(', ≤ 9.22.*', '', f.bounds)} {f.unit.strip('-')}".strip(),
        )
        for f in found
    ]
    if not rows:
        return ["It has no settings."]
    return ["", *_rows(("setting", "meaning", "default", "allowed"), rows)]


def _value(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Settings):
        return "its section"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return str(value.get("name", dict(value)))
    if isinstance(value, Enum):
        return str(value.value)
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _cell(text: object) -> str:
    """Return a text as a cell of a table, in which only literals are markup."""
    parts = re.split(r"(`[^`]*`)", _roles(" ".join(str(text).split())))
    plain = (re.sub(r"([<*_\[\]])", r"\\\1", part) for part in parts[::2])
    parts[::2] = list(plain)
    return "".join(parts).replace("|", r"\|")


def _summary(cls: type) -> str:
    return _roles((inspect.getdoc(cls) or "").partition("\n\n")[0])


def _roles(text: str) -> str:
    """Return a docstring as Markdown: its literals have single backticks."""
    return text.replace("``", "`")


def _subcommands(command: Any, path: str = "flipperctl") -> Iterator[tuple[str, Any]]:
    """Yield the path and the command of each subcommand at any depth, groups before theirs."""
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from _subcommands(inner, f"{path} {name}")


def _command(path: str, command: Any) -> Iterator[str]:
    words, _, examples = re.sub(r"\[/?\w*\]", "", command.help).partition("Examples")
    yield from (f"## `{path}`", "", inspect.cleandoc(words), "")
    lines = [line.strip() for line in examples.splitlines() if line.strip()]
    for commands, found in groupby(lines, lambda line: line.startswith("flipperctl ")):
        if commands:
            yield from ("```console", *(f"$ {line}" for line in found), "```", "")
        else:
            yield from (*found, "")
    shown = [parameter for parameter in command.params if parameter.name != "help"]
    if shown:
        yield from ("| argument or option | default | meaning |", "|---|---|---|")
    for parameter in shown:
        names = ", ".join((*parameter.opts, *parameter.secondary_opts))
        if parameter.param_type_name == "argument":
            names = parameter.metavar or parameter.name.upper()
        elif parameter.metavar:
            names += f" {parameter.metavar}"
        default = "" if parameter.default in (None, False, ()) else parameter.default
        help_ = getattr(parameter, "help", "") or ""
        yield f"| {_cell(f'`{names}`')} | {_cell(default)} | {_cell(help_)} |"
    yield ""


def _entry(module: str, name: str, value: object) -> list[str]:
    path = f"{module}.{name}"
    if inspect.isclass(value) and get_origin(value) is None:
        return [f".. autoclass:: {path}", "   :members:"]
    if inspect.isroutine(value):
        return [f".. autofunction:: {path}"]
    words = _attribute_doc(module, name)
    return [f".. py:data:: {path}", "", *(f"   {line}" for line in words)]


def _attribute_doc(module: str, name: str) -> list[str]:
    """Return the string below the assignment of a module's name, wherever it was imported from."""
    for inner in (*sorted(_modules(module)), *sorted(_modules("flipperctl.core"))):
        found = ModuleAnalyzer.for_module(inner).find_attr_docs()
        if ("", name) in found:
            return list(found["", name])
    return []


def _modules(package: str) -> Iterator[str]:
    import pkgutil

    found = importlib.import_module(package)
    yield package
    for info in pkgutil.iter_modules(found.__path__, f"{package}."):
        yield info.name
