"""``flipperctl inspect config``."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.command import TrainingCommand
from flipperctl.cli.options import AsJson, Overrides, PluginPaths

if TYPE_CHECKING:
    from flipperctl.config import TrainConfig

HELP = """Print the composed, validated training configuration as YAML.

With [bold]--describe[/], list every setting of it instead: value, default, bounds, unit, meaning.

[bold]Examples[/]

  flipperctl inspect config terrain=stair

  flipperctl inspect config experiment=wide_stair agent.gamma=0.98 --json

  flipperctl inspect config terrain=ramp rewards=tuned --describe
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("config", help=HELP, cls=TrainingCommand)(show)


def show(
    overrides: Overrides = None,
    describe: Annotated[
        bool, typer.Option("--describe", help="List every setting with default, bounds and unit.")
    ] = False,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from omegaconf import OmegaConf

    from flipperctl import plugins as loader
    from flipperctl.cli.hydra import compose, config_store
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import container

    loader.load(plugins or ())
    config_store.register_defaults()
    config = compose.only_one(compose.compose_train(Overrides.parse(overrides or ())))
    if describe:
        (default,) = compose.compose_train()
        found = list_settings(config, default)
        if as_json:
            print(json.dumps(found, indent=2))
        else:
            _print(found)
        return
    plain = container(config)
    print(json.dumps(plain, indent=2) if as_json else OmegaConf.to_yaml(plain).rstrip())


def list_settings(config: TrainConfig, default: TrainConfig) -> list[dict[str, Any]]:
    """Return every setting as plain data; ``default`` has the default plugin of each kind."""
    from flipperctl.config.describe import settings

    choices = {s.path: s.value for s in settings(default)}
    return [
        {
            "section": s.section,
            "path": s.path,
            "value": s.value,
            "default": choices.get(s.path) if s.path == s.section else s.field.default,
            "bounds": s.field.bounds,
            "unit": s.field.unit,
            "type": s.field.type,
            "description": s.field.description,
        }
        for s in settings(config)
    ]


def _print(found: Iterable[dict[str, Any]]) -> None:
    """Print a table per section; values that differ from the default are bold."""
    from itertools import groupby

    from rich.text import Text

    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

    out = console(natural=120)
    headings = ("setting", "value", "default", "bounds", "unit", "meaning")
    for section, settings in groupby(found, key=lambda s: str(s["section"])):
        table = Table(headings, words=["value", "default", "bounds", "meaning"], boxed=False)
        for s in settings:
            value, default = _format_value(s["value"]), _format_value(s["default"])
            path = s["path"].removeprefix(f"{section}.")
            table.add(
                path,
                Text(value, "" if value == default else "bold"),
                *(default, s["bounds"], s["unit"], str(s["description"])),
            )
        out.print(Text(section or "top level", "bold"))
        table.print(out)
        out.print()


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, list):
        return f"[{', '.join(map(_format_value, value))}]"
    if isinstance(value, dict):
        return str(value.get("name", value))  # a plugin's fields have their own rows
    return f"{value:.4g}" if isinstance(value, float) else str(value)
