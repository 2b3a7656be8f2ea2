"""``flipperctl robot shadow``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Run an exported policy on what a robot recorded, and log what it would have done.

Nothing moves: POLICY is stepped as on the robot (flipperctl.runtime.FlipperController) with the
messages of BAG in their order. The log has a line of JSON for each decision and each change of
state: time, proposed targets and setpoints, whether the belts might run, state, fault and reason,
and the angles that were measured.

OVERRIDES are widths and errors of the robot, as in perception.overall_width=0.6.

[bold]Examples[/]

  flipperctl robot shadow stair.onnx recorded_bag --output shadow.jsonl

  flipperctl robot shadow stair.onnx run.mcap perception.pose=matched
"""


def run(
    policy: Annotated[Path, typer.Argument(help="An exported policy, an .onnx file.")],
    bag: Annotated[Path, typer.Argument(help="A bag of ROS 1 or 2.")],
    overrides: options.Overrides = None,
    output: Annotated[Path, typer.Option(metavar="FILE.jsonl", help="The log to write.")] = Path(
        "shadow.jsonl"
    ),
    topic: options.CloudTopic = None,
    imu: options.ImuTopic = None,
    belts: options.BeltTopic = None,
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
    from flipperctl.ros.shadowing import check_used, shadow
    from flipperctl.ros.topics import Names
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_shadow

    config, pose, given = recorded_robot(overrides)
    check_used(given)
    joints = front or JOINTS[:2], rear or JOINTS[2:]
    names = Names(topic, imu, belts, "odom", base_frame, *joints, signs.value)
    found = shadow(policy, bag, config.perception, pose, names, output)
    show(found, lambda: print_shadow(found), as_json=as_json)
