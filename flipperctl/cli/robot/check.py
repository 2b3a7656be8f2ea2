"""``flipperctl robot check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Replay what a robot recorded through the estimator that runs on it: will its sensing do?

BAG is a bag of ROS 1 or 2, or a folder of clouds and poses.txt (see flipperctl robot ground). The
table tells which scans are used, how much ground is seen, how certain it is and how the odometry
drifts. --output shows the cloud, the map, heights, faces, filled and unseen ground: a film (.gif),
or with --at SECONDS one instant (.png, .svg, .pdf).

OVERRIDES are the robot and the estimator, as in robot=absolem perception.pose=matched.

[bold]Examples[/]

  flipperctl robot check recorded_bag --output perceived.gif

  flipperctl robot check run.mcap robot=mine.yaml --topic /points --json

  flipperctl robot check recorded_bag --at 12 --output edge.png
"""


def run(
    bag: Annotated[Path, typer.Argument(help="A bag, or a folder of clouds and poses.txt.")],
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A film .gif; with --at a picture .png.")
    ] = None,
    at: Annotated[float | None, typer.Option(min=0, help="Time of a picture in s.")] = None,
    topic: options.CloudTopic = None,
    imu: options.ImuTopic = None,
    belts: options.BeltTopic = None,
    fixed_frame: options.FixedFrame = "odom",
    base_frame: options.BaseFrame = "base_link",
    front: options.FrontJoints = None,
    rear: options.RearJoints = None,
    signs: options.AngleSigns = options.Convention.rep103,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.robot import recorded_robot
    from flipperctl.ros.messages import JOINTS
    from flipperctl.ros.perceiving import replay
    from flipperctl.ros.topics import Names
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_perception

    if output is not None or at is not None:
        from flipperctl.figures.perceiving import check_output, draw

        check_output(output, at)
    joints = front or JOINTS[:2], rear or JOINTS[2:]
    names = Names(topic, imu, belts, fixed_frame, base_frame, *joints, signs.value)
    config, pose, _ = recorded_robot(overrides)
    found = replay(bag, config.perception, config.robot, pose, names)
    if output is not None:
        with episodes_progress("drawing", 1) as report:
            draw(output, found, config.robot, at, report)
    show(found.summary, lambda: print_perception(found.summary, output), as_json=as_json)
