"""``flipperctl transfer``: a policy in the side plane and in 3-D on the same episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

HELP = """Evaluate a policy in the side plane and in 3-D on the same episodes; explain its failures.

Each episode is played in the default engine and in sim=mujoco, or the engine named by sim=…, with
the same ground, start and sampled physics. The differences are paired by seed, with 95 %
intervals. Each failure in 3-D is replayed to find its cause: overturned (by pitch), roll, heading
(turned away or off the ground), traction (reached with twice the friction), or stuck.

With perception=lidar, both engines perceive the true ground, and a third column has 3-D with the
LiDAR. Its failures are also due to drift (reached with the true pose) or perception (reached on the
true ground).

Settings of sim are those of the 3-D engine; friction and gravity apply to both.

[bold]Examples[/]

  flipperctl transfer --controller okada terrain=stair,plum --episodes 50

  flipperctl transfer --checkpoint generalist terrain=ramp sim.yaw=0.087 sim.lateral_slope=0.087

  flipperctl transfer --checkpoint generalist terrain=stair perception=lidar perception.pose=belts

  flipperctl transfer --controller okada terrain=plum --seed 3 --only 4 --film plum.gif
"""


def run(
    overrides: options.Overrides = None,
    checkpoint: options.CheckpointFile = None,
    controller: options.ControllerName = None,
    episodes: options.Episodes = None,
    only: Annotated[
        int | None, typer.Option(min=0, metavar="INDEX", help="Play this episode alone, from 0.")
    ] = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for transfer.json.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(metavar="FILE.gif", help="Film of the episode --only in 3-D."),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.hydra.compose import only_one
    from flipperctl.cli.scenes import scenes
    from flipperctl.config.words import with_engine, with_flags
    from flipperctl.evaluation.workers import EpisodeWorkers
    from flipperctl.report.drawn_film import film_episode
    from flipperctl.report.film import check_film
    from flipperctl.runs.named_policies import require_one_policy
    from flipperctl.runs.results import json_result
    from flipperctl.studies.engines import in_default_engine
    from flipperctl.studies.transfer import transfer_scenes
    from flipperctl.terminal.document import show
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.streams import print_note
    from flipperctl.terminal.transfer import print_transfer

    require_one_policy(checkpoint, controller, overrides)
    if film and only is None:
        raise RequestError("--film shows one episode; name it with --only INDEX")
    arguments = with_flags(overrides, episodes=episodes, seed=seed, jobs=jobs)
    asked = scenes(with_engine(arguments), checkpoint, controller)
    for config, _ in asked:
        in_default_engine(config)  # raises for a wrong engine, before the first episode
    if film:
        check_film(film)
        only_one(asked)
    with json_result(output, "transfer") as write, EpisodeWorkers() as workers:
        found = transfer_scenes(asked, workers, only, episodes_progress)
        document = {"controller": found[0].controller, "scenes": [one.to_dict() for one in found]}
        policy = ["--checkpoint" if checkpoint else "--controller", str(checkpoint or controller)]
        show(document, lambda: print_transfer(found, policy, overrides or []), as_json=as_json)
        write(document)
        if film:
            film_episode(*only_one(asked), only or 0, film)
            print_note(f"wrote {film}")
