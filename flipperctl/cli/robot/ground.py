"""``flipperctl robot ground``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Make recorded ground from a bag of ROS 1 or 2, or from a folder of clouds with poses.

The points of all clouds are put into one frame by the recorded transforms or odometry, without
those of the robot, and thinned. The command prints how to drive over them (terrain=profile_file).
A folder has clouds (.pcd, .ply, .xyz, .npy) in the frame of the chassis, and poses.txt with a line
for each: 8 numbers (stamp, x, y, z, qx, qy, qz, qw), or 12 (the rows of [[R|t]]).

OVERRIDES are the robot that recorded, as in robot=absolem, whose own points are left out.

[bold]Examples[/]

  flipperctl robot ground recorded_bag --output ground.xyz

  flipperctl robot ground run.mcap --output ground.xyz --fixed-frame map
"""


def run(
    source: Annotated[Path, typer.Argument(help="A bag, or a folder of clouds and poses.txt.")],
    output: Annotated[Path, typer.Option(metavar="FILE.xyz", help="The file to write.")],
    overrides: options.Overrides = None,
    topic: options.CloudTopic = None,
    fixed_frame: options.FixedFrame = "odom",
    base_frame: options.BaseFrame = "base_link",
    reach: Annotated[
        float,
        typer.Option(min=0.5, help="Distance in m beyond which points are left out."),
    ] = 5.0,
    cell: Annotated[
        float,
        typer.Option(min=0.005, max=0.2, help="One point is kept in a cube of this edge in m."),
    ] = 0.02,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.api import Robot
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.export.policy import robot_fields
    from flipperctl.ros.ground import convert
    from flipperctl.ros.topics import Names
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_ground

    robot = Robot(**robot_fields(Overrides.parse(overrides or ()).values(), "robot ground"))
    names = Names(clouds=topic, fixed=fixed_frame, base=base_frame)
    found = convert(source, output, robot, names, reach, cell)
    show(found, lambda: print_ground(found), as_json=as_json)
