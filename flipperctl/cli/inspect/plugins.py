"""``flipperctl inspect plugins``."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from flipperctl.cli.options import AsJson, PluginPaths

HELP = """List every registered plugin: its source, and each field with default, bounds and unit.

With [bold]--check[/], run the conformance suite on them instead: terrains at every bound, rewards
on recorded episodes of every outcome, networks up to ONNX, controllers against the clock.

[bold]Examples[/]

  flipperctl inspect plugins

  flipperctl inspect plugins stair --json

  flipperctl inspect plugins --plugins my_terrain.py

  flipperctl inspect plugins mine --check --plugins mine.py --output pictures
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("plugins", help=HELP)(show)


def show(
    name: Annotated[str | None, typer.Argument(help="Only the plugins of this name.")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Run the conformance suite; fail if a check fails.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --check: a folder for the terrains' pictures."),
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import plugins as loader
    from flipperctl.api import registry
    from flipperctl.errors import PluginError, RequestError
    from flipperctl.messages import close_match

    if output is not None and not check:
        raise RequestError("--output is for the pictures of --check; inspect terrain draws one")

    loader.load(plugins or ())
    known = {plugin for _, plugin in registry}
    if name is not None and name not in known:
        raise PluginError(f"there is no plugin {name!r}{close_match(name, known)}")
    chosen = [(k, n) for k, n in sorted(registry) if name in (None, n)]
    if check:
        from flipperctl.cli.inspect import conformance

        conformance.check([registry[key] for key in chosen], output, as_json=as_json)
        return
    found = [describe(*key) for key in chosen]
    if as_json:
        print(json.dumps(found, indent=2))
        return
    _print(found)


def describe(kind: str, name: str) -> dict[str, Any]:
    """Return a plugin and its fields as plain data."""
    from flipperctl.api import registry
    from flipperctl.config import resolver
    from flipperctl.config.describe import fields

    cls = registry[kind, name]
    return {
        "kind": kind,
        "name": name,
        "summary": (cls.__doc__ or "").strip().splitlines()[0] if cls.__doc__ else "",
        "module": cls.__module__,
        "source": resolver.source(cls),
        "fields": [asdict(field) for field in fields(cls)],
    }


def _print(found: list[dict[str, Any]]) -> None:
    from rich.text import Text

    from flipperctl.terminal.console import console, plain
    from flipperctl.terminal.tables import Table

    output = console()

    def text(words: object, style: str = "") -> Text:
        return Text(plain(str(words), output), style)

    for plugin in found:
        kind = f"  {plugin['kind']}  "
        output.print(text(plugin["name"], "bold") + text(kind) + text(plugin["summary"]))
        output.print(text(f"  {plugin['source']}", "dim"), soft_wrap=True)
        if plugin["fields"]:
            headings = ("  field", "default", "bounds", "unit", "meaning")
            table = Table(headings, words=["default", "bounds", "meaning"], boxed=False)
            for field in plugin["fields"]:
                default = field["default"]
                shown = f"{default:.4g}" if isinstance(default, float) else str(default)
                cells = (f"  {field['name']}", shown, field["bounds"], field["unit"])
                table.add(*cells, field["description"])
            table.print(output)
        output.print()
