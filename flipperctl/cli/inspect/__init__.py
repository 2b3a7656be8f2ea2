"""``flipperctl inspect``: what is there, and what it does."""

import typer

from flipperctl.cli.inspect import checkpoint, config, plugins, reward, run, terrain


def add_to(app: typer.Typer) -> None:
    """Register the group with its subcommands."""
    group = typer.Typer(
        name="inspect",
        help="Look at plugins, terrains, rewards, checkpoints, runs and configurations.",
        no_args_is_help=True,
        rich_markup_mode="rich",
    )
    for module in (plugins, terrain, reward, checkpoint, run, config):
        module.add_to(group)
    app.add_typer(group)
