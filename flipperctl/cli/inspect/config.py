"""``flipperctl inspect config``."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.cli.command import TrainingCommand

COMMAND = TrainingCommand
HELP = """Print the composed, validated training configuration as YAML.

With [bold]--describe[/], list its settings instead: value, default, bounds, unit and meaning.

[bold]Examples[/]

  flipperctl inspect config terrain=stair

  flipperctl inspect config experiment=wide_stair agent.gamma=0.98 --json

  flipperctl inspect config terrain=ramp rewards=tuned --describe
"""


def run(
    overrides: options.Overrides = None,
    describe: Annotated[
        bool, typer.Option("--describe", help="List every setting with default, bounds and unit.")
    ] = False,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from omegaconf import OmegaConf

    from flipperctl.cli.hydra import compose
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import to_dict
    from flipperctl.config.describe import list_settings
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_settings

    config = compose.only_one(compose.compose_train(Overrides.parse(overrides or ())))
    if describe:
        (default,) = compose.compose_train()
        found = list_settings(config, default)
        show(found, lambda: print_settings(found), as_json=as_json)
        return
    plain = to_dict(config)
    show(plain, lambda: print(OmegaConf.to_yaml(plain).rstrip()), as_json=as_json)
