"""A subcommand of your own: how much a policy rocks on two kinds of ground.

Try it: ``flipperctl rougher okada --plugins examples/rougher.py``
"""

from typing import Annotated

import typer

from flipperctl.api import command


@command("rougher")
def rougher(
    policy: Annotated[str, typer.Argument(help="A policy, such as okada.")],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes on each terrain.")] = 2,
) -> None:
    """Print how much the robot rocks on a step and on a ramp.

    [bold]Examples[/]

      flipperctl rougher okada --episodes 5
    """
    import flipperctl  # here, so that --help is quick

    terrains = ["step", "ramp"]
    result = flipperctl.evaluate(policy, terrain=terrains, baselines=[], episodes=episodes)
    for scene in result.scenes:
        print(f"{scene['terrain']}: {scene['pitch_variation_100hz']['mean']:.2f} rad")
