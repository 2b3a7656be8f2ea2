"""``python -m benchmarks``: benchmarks for developers, with the options of ``bench``."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from benchmarks.settings import MEASURES, run
from flipperctl.cli import options
from flipperctl.cli.command import App, Command
from flipperctl.cli.main import run_app
from flipperctl.commands import bench
from flipperctl.process import entry
from flipperctl.terminal.streams import replace_missing_characters

HELP = """Measure flipperctl against its limits and another learner, in a clone of the repository.

[bold]engines[/] simulated time per CPU time of each engine, alone and in the environment;
[bold]learner[/] updates per second; [bold]latency[/] an exported policy, checkpoints, memory of a
training; [bold]scaling[/] decisions per second by worker processes;
[bold]physics[/] the environment against Chipmunk alone; [bold]accuracy[/] of the substep;
[bold]lookahead[/] decisions of mpc, and its prediction model against environment and engine;
[bold]lidar[/] episodes with a simulated LiDAR, by odometry and number of rays;
[bold]updates[/] against Stable-Baselines3's DQN; [bold]solve[/] time until unseen episodes succeed,
also against it; [bold]startup[/] of each command. Contestants run in turn; medians with quartiles.

OVERRIDES are those of train and bench.<key>=…: repeats, seed, controller, episodes, starts,
families, updates, batch_sizes, transitions, calls, decisions, workers, seeds, limit,
validate_every, validation_episodes, in_a_row, commands. lidar drives step in 3-D,
accuracy and lookahead have scenes of their own: other words for terrain, sim and perception
change nothing there.

[bold]Examples[/]

  python -m benchmarks physics updates

  python -m benchmarks --small --json

  python -m benchmarks solve bench.seeds=3 bench.limit=300 terrain=step --output speed
"""

app = App(add_completion=False)


@app.command(help=HELP, cls=Command)
def benchmarks(
    arguments: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[MEASURE]... [OVERRIDE]...",
            help=f"all, {', '.join(MEASURES)}; and key=value.",
            show_default=False,
        ),
    ] = None,
    small: bench.Small = False,
    repeats: Annotated[str | None, typer.Option(metavar="N", help="Rounds [10].")] = None,
    output: bench.OutputFolder = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    run(arguments or [], repeats, output, small=small, as_json=as_json)


if __name__ == "__main__":
    replace_missing_characters()
    entry.run(lambda: run_app(app, sys.argv[1:], "python -m benchmarks"))
