"""``flipperctl inspect``: views of plugins, terrains, rewards, runs, settings and engines."""

from importlib import import_module

import typer

from flipperctl.cli.command import App

VIEWS = ("plugins", "terrain", "reward", "checkpoint", "run", "config", "engines", "conventions")
"""Modules beside this one, each with a subcommand; help lists them in this order."""


def add_to(app: typer.Typer) -> None:
    """Register the group with its subcommands."""
    group = App(
        name="inspect",
        help="Look at plugins, terrains, rewards, checkpoints, runs, configurations and engines.",
        no_args_is_help=True,
        rich_markup_mode="rich",
    )
    for name in VIEWS:
        import_module(f"{__name__}.{name}").add_to(group)
    app.add_typer(group)
