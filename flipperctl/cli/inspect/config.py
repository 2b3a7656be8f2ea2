"""``flipperctl inspect config``."""

from __future__ import annotations

import json

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths

HELP = """Print the composed, validated training configuration as YAML.

[bold]Examples[/]

  flipperctl inspect config terrain=stair

  flipperctl inspect config experiment=wide_stair agent.gamma=0.98 --json
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("config", help=HELP)(show)


def show(overrides: Overrides = None, as_json: AsJson = False, plugins: PluginPaths = None) -> None:
    """See HELP."""
    from omegaconf import OmegaConf

    from flipperctl import plugins as loader
    from flipperctl.cli import compose
    from flipperctl.config import container

    loader.load(plugins or ())
    compose.offer_defaults()
    config, *_ = compose.compose_train(overrides or [])
    plain = container(config)
    print(json.dumps(plain, indent=2) if as_json else OmegaConf.to_yaml(plain).rstrip())
