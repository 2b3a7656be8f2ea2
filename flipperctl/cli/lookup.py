"""``flipperctl list`` and ``flipperctl explain``: names by kind; settings, plugins and words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note, show

if TYPE_CHECKING:
    from flipperctl.cli.catalogue import Entry, Key


def list_names(
    kind: Annotated[
        str | None, typer.Argument(metavar="[KIND]", help="What to list, such as terrains.")
    ] = None,
    folder: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="With runs: where they are.")
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="With terrains: a picture of each (.png, .svg, .pdf).",
            callback=options.check_picture,
        ),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """List what there is: terrains, rewards, networks, policies, presets, runs and more.

    Without a KIND, show all kinds. [bold]flipperctl explain NAME[/] tells more about one name.

    [bold]Examples[/]

      flipperctl list

      flipperctl list terrains --pictures terrains.png

      flipperctl list runs

      flipperctl list experiments --json
    """
    from flipperctl.cli import catalogue
    from flipperctl.terminal import names as printed

    if pictures is not None and kind not in ("terrain", "terrains"):
        raise RequestError("--pictures needs terrains: flipperctl list terrains --pictures FILE")
    if folder is not None and kind not in ("run", "runs"):
        raise RequestError(f"{folder}: a folder has a meaning with runs alone: list runs FOLDER")
    if kind is None:
        kinds = _kinds()
        show(kinds, lambda: printed.print_kinds(kinds), as_json=as_json)
        return

    # One kind: runs are found in folders, all others in the catalogue.
    kind_name = _kind(kind)
    document: dict[str, Any] = {"kind": kind_name}
    if kind_name == "runs":
        place = folder or Path("runs")
        document["names"] = catalogue.runs(place)
        show(document, lambda: printed.print_runs(place, document["names"]), as_json=as_json)
        return
    if pictures is not None:
        _draw(pictures)
    listed = [entry for group in catalogue.KINDS[kind_name] for entry in catalogue.entries(group)]
    document["names"] = [
        {"name": e.name, "group": e.group, "summary": e.summary, "command": e.command}
        for e in listed
    ]
    titles = {name: group.command for name, group in catalogue.KINDS[kind_name].items()}
    show(document, lambda: printed.print_names(document["names"], titles), as_json=as_json)


def explain(
    context: typer.Context,
    words: Annotated[
        list[str], typer.Argument(metavar="WORD...", help="A setting, a name, or words to search.")
    ],
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Explain a setting, a name or a word; search for anything else.

    Of a setting: meaning, unit, allowed values, default, and which presets change it. Of a plugin:
    its settings. Of a preset: what it sets. Of a word of our tables: what it means.

    [bold]Examples[/]

      flipperctl explain agent.gamma

      flipperctl explain stair

      flipperctl explain pitch variation

      flipperctl explain friction --json
    """
    from flipperctl.cli import catalogue
    from flipperctl.cli.glossary import GLOSSARY
    from flipperctl.terminal import names as printed
    from flipperctl.text.elsewhere import called_here, here
    from flipperctl.text.messages import close_match

    # A word of the tables, a name or a setting; otherwise the nearest ones
    word = " ".join(words)
    commands = _commands(context)
    glossary = {w.lower(): text for w, text in GLOSSARY.items()}
    meaning, lines, looked_up = glossary.get(word.lower()), tuple[str, ...](), word
    if meaning is None and (foreign := here(word)):
        meaning, lines = foreign.meaning, foreign.lines
        if not meaning:  # a setting, or a word of ours
            looked_up, lines = foreign.ours[0], ()
            meaning = glossary.get(looked_up)
    named = [
        entry
        for groups in catalogue.KINDS.values()
        for group in groups
        if group != "run"
        for entry in catalogue.entries(group)
        if looked_up in (entry.name, f"{entry.group}={entry.name}")
    ]
    keys = catalogue.keys_named(looked_up)
    hits = [] if meaning or named or keys else catalogue.search(word, commands)
    if not (meaning or named or keys or hits):
        nearest = close_match(word, [*catalogue.names(), *commands])
        hint = called_here(word.rpartition(".")[2]) or nearest
        raise RequestError(f"nothing is called {word!r}{hint}; flipperctl list shows all kinds")
    document = {
        "word": word,
        "meaning": meaning,
        "lines": lines,
        "names": [_described(entry) for entry in named],
        "settings": list(_settings(keys)),
        "found": [asdict(hit) for hit in hits],
    }

    show(document, lambda: printed.print_explained(document), as_json=as_json)


def _kind(word: str) -> str:
    """Return the kind that a word names, in the singular or the plural."""
    from flipperctl.cli.catalogue import KINDS, entries
    from flipperctl.text.messages import unknown

    groups = {group: kind for kind, inner in KINDS.items() for group in inner}
    if kind := word if word in KINDS else groups.get(word):
        return kind
    if any(e.name == word for g in groups if g != "run" for e in entries(g)):
        raise RequestError(f"{word} is no kind but a name: flipperctl explain {word}")
    raise RequestError(unknown("there is no kind", word, KINDS))


def _kinds() -> list[dict[str, Any]]:
    """Return each kind with the number of its names and an example."""
    from flipperctl.cli.catalogue import KINDS, entries, runs

    rows, place = [], Path("runs")
    for kind, groups in KINDS.items():
        lists = [runs(place) if place.is_dir() else []] if kind == "runs" else map(entries, groups)
        group = next(iter(groups.values()))
        example = group.command.replace("NAME", group.example)
        rows.append({"kind": kind, "count": sum(map(len, lists)), "example": example})
    return rows


def _draw(file: Path) -> None:
    """Draw every terrain that needs no file; those that are made of others come last."""
    from flipperctl.api import Profile, Robot, Terrain
    from flipperctl.cli.catalogue import entries
    from flipperctl.errors import FlipperctlError
    from flipperctl.figures.figure import save
    from flipperctl.figures.terrain import contact_sheet, sample
    from flipperctl.requests.compose import compose_environment
    from flipperctl.requests.text import from_words

    ground, composed = dict[str, Profile](), dict[str, Profile]()
    for entry in entries("terrain"):
        try:
            config = compose_environment(from_words([f"terrain={entry.name}"]))
            # A field is a terrain, or several.
            fields = [value for _, value in config.terrain]
            parts = [part for f in fields for part in (f if isinstance(f, tuple) else (f,))]
            kind = composed if any(isinstance(part, Terrain) for part in parts) else ground
            kind[entry.name] = sample(config, [0])[0][0]
        except FlipperctlError as error:
            print_note(f"no picture of {entry.name}: {error}")
    save(contact_sheet(ground | composed, Robot()), file)
    print_note(f"wrote {file}")


def _commands(context: typer.Context) -> dict[str, str]:
    """Return the help of each subcommand, by name."""
    # The help of each command is what explain searches, too.
    root: Any = context.find_root().command
    commands: dict[str, Any] = {}
    for name, command in root.commands.items():
        below = getattr(command, "commands", None) or {}
        commands |= {
            f"flipperctl {name} {inner}": subcommand for inner, subcommand in below.items()
        }
        commands |= {} if below else {f"flipperctl {name}": command}
    return {
        name: re.sub(r"\[/?\w*\]", "", command.help or "") for name, command in commands.items()
    }


def _described(entry: Entry) -> dict[str, Any]:
    """Return what is known about a name as plain data; of a plugin, its fields."""
    from flipperctl.api import registry
    from flipperctl.config.describe import describe_plugin

    description: dict[str, Any] = {
        "name": entry.name,
        "group": entry.group,
        "summary": entry.summary,
        "command": entry.command,
        "about": entry.about,
        "settings": dict(entry.settings),
    }
    key = entry.group, entry.name
    return description | ({"plugin": describe_plugin(*key)} if key in registry else {})


def _settings(keys: Sequence[Key]) -> Iterator[dict[str, Any]]:
    """Yield what is known about settings as plain data.

    ``train``: the value that ``flipperctl train`` has unless it is told otherwise; None for a
    setting of a plugin that it does not use then.
    """
    from flipperctl.cli.catalogue import first_clause, set_by
    from flipperctl.config.describe import settings
    from flipperctl.requests.compose import compose_train, only_one

    # What a training has by default, beside the plugin's own default
    values = {s.path: s.value for s in settings(only_one(compose_train()))} if keys else {}
    for key in keys:
        section, name = key.key.rpartition(".")[0], key.owner.partition(" ")[2]
        used = not name or values.get(section) == name
        if not section:  # a name, or those of several plugins
            below = (path.split(".") for path in values if path.startswith(f"{key.key}."))
            default = values.get(key.key, [child for _, child, *more in below if not more])
            key = replace(key, field=replace(key.field, default=default))
        yield {
            "key": key.key,
            "of": key.owner,
            **{k: v for k, v in asdict(key.field).items() if k not in ("name", "type")},
            "class": f"{key.cls.__module__}.{key.cls.__name__}",
            "set_by": set_by(key),
            "train": values.get(key.key) if used else None,
            "alias": key.alias,
            "short": first_clause(key.field.description),
            "command": key.command(used=used),
        }
