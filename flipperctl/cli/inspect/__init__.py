"""``flipperctl inspect``: views of plugins, terrains, rewards, files, runs and settings."""

from importlib import import_module

from flipperctl.cli.command import App

VIEWS = ("plugins", "terrain", "reward", "checkpoint", "run", "config", "perception")
"""Modules beside this one, each with a subcommand; help lists them in this order."""


def group() -> App:
    """Return the group with its subcommands."""
    views = App(
        name="inspect",
        help="Look at plugins, terrains, rewards, files, runs and settings.",
        no_args_is_help=True,
        rich_markup_mode="rich",
    )
    for name in VIEWS:
        views.add(name, import_module(f"{__name__}.{name}"))
    return views
