"""Check a robot's sensing and signs, and use what it recorded."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from flipperctl.cli import options
from flipperctl.terminal.streams import show

if TYPE_CHECKING:
    from flipperctl.config import EvalConfig
    from flipperctl.runtime.devices import Devices


class Convention(StrEnum):
    """Signs of flipper angles."""

    rep103 = "rep103"
    flipperctl = "flipperctl"


class Ended(StrEnum):
    """How a drive ended, as an operator says."""

    reached = "reached"
    overturned = "overturned"
    stuck = "stuck"


CloudTopic = Annotated[
    str | None,
    typer.Option("--topic", metavar="NAME", help="Topic of the PointCloud2, if several."),
]
ImuTopic = Annotated[
    str | None, typer.Option("--imu", metavar="NAME", help="Topic of the Imu, if several.")
]
BeltTopic = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Belt speeds, Float64 or Odometry; /belt_speed or the only Odometry if not given.",
    ),
]
FixedFrame = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Frame in which the ground is at rest; odom if not given.",
        show_default=False,
    ),
]
BaseFrame = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Frame of the chassis; base_link if not given.", show_default=False
    ),
]
FrontJoints = Annotated[
    list[str] | None,
    typer.Option(
        "--front", metavar="JOINT", help="A joint of the front flippers; may be repeated."
    ),
]
RearJoints = Annotated[
    list[str] | None,
    typer.Option("--rear", metavar="JOINT", help="A joint of the rear flippers; may be repeated."),
]
AngleSigns = Annotated[
    Convention | None,
    typer.Option(
        metavar="NAME",
        help="Signs of the flippers' angles; rep103 if not given.",
        show_default=False,
    ),
]


class Recorded(NamedTuple):
    """The robot of a recording."""

    config: EvalConfig
    """Robot and LiDAR, and the scene of an evaluation."""
    pose: str | None
    """``perception.pose`` or that of the devices; None if neither is given."""
    keys: frozenset[str]
    """The settings that were given."""
    devices: Devices


def recorded_robot(overrides: Sequence[str] | None, usual: Devices | None = None) -> Recorded:
    """Return the robot of a recording by the words of a command line.

    ``usual``: the devices if no others are named.
    """
    from flipperctl.requests.compose import compose_environment
    from flipperctl.requests.request import Request, Requests
    from flipperctl.requests.text import from_words
    from flipperctl.runtime.devices import Devices

    typed = from_words(list(overrides or ()))
    # What the devices say of the LiDAR, in a file of their own or the robot's, counts here too.
    devices, rest = typed.devices() or usual, typed.without_devices
    words = dict(rest.typed)
    ours = devices.perception() if devices is not None else {}
    settings = [Request(f"perception.{n}", v) for n, v in ours.items()]
    known = [request for request in settings if request.key not in words]
    lidar = [] if "perception" in words else [Request("perception", "lidar")]
    config = compose_environment(Requests.of(lidar, known, rest))
    keys = frozenset(words)
    stated = devices is not None or "perception.pose" in keys
    pose = getattr(config.perception, "pose", None) if stated else None
    return Recorded(config, pose, keys, devices or Devices())


def check(
    bag: Annotated[Path, typer.Argument(help="A bag, or a folder of clouds and poses.txt.")],
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A film .gif; with --at a picture .png.")
    ] = None,
    at: Annotated[
        float | None, typer.Option(metavar="S", min=0, help="Time of a picture in s.")
    ] = None,
    topic: CloudTopic = None,
    imu: ImuTopic = None,
    belts: BeltTopic = None,
    fixed_frame: FixedFrame = None,
    base_frame: BaseFrame = None,
    front: FrontJoints = None,
    rear: RearJoints = None,
    signs: AngleSigns = None,
    as_json: options.AsJson = False,
) -> None:
    """Replay what a robot recorded through the estimator that runs on it: will its sensing do?

    BAG is a bag of ROS 1 or 2, or a folder of clouds and poses.txt (see flipperctl robot ground).
    The table tells which scans are used, how much ground is seen, how certain it is and how the
    odometry drifts. A film shows cloud, map, heights, faces, filled and unseen ground (--output
    FILE.gif), or with --at SECONDS a picture shows one instant (.png, .svg, .pdf).

    OVERRIDES are the robot, its devices and the estimator, as in robot=absolem
    perception.pose=matched, or robot=mine.yaml devices=mine.yaml.

    [bold]Examples[/]

      flipperctl robot check recorded_bag --output perceived.gif

      flipperctl robot check run.mcap robot=mine.yaml --topic /points --json

      flipperctl robot check recorded_bag --at 12 --output edge.png
    """
    from flipperctl.ros.perceiving import replay
    from flipperctl.ros.topics import Names
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.tables import print_perception

    if output is not None or at is not None:
        from flipperctl.figures.perceived import check_perceived, draw_perceived

        check_perceived(output, at)
    config, pose, _, devices = recorded_robot(overrides)
    joints = {"front": front or None, "rear": rear or None, "signs": signs and signs.value}
    topics = {"clouds": topic, "imu": imu, "belts": belts}
    names = Names.of(devices, fixed=fixed_frame, base=base_frame, **topics, **joints)
    replayed = replay(bag, config.perception, config.robot, pose, names)
    if output is not None:
        with episodes_progress("drawing", 1) as report:
            draw_perceived(output, replayed, config.robot, at, report)
    show(replayed.summary, lambda: print_perception(replayed.summary, output), as_json=as_json)


def shadow(
    policy: Annotated[Path, typer.Argument(help="An exported policy, an .onnx file.")],
    bag: Annotated[Path, typer.Argument(help="A bag of ROS 1 or 2.")],
    overrides: options.Overrides = None,
    output: Annotated[Path, typer.Option(metavar="FILE.jsonl", help="The log to write.")] = Path(
        "shadow.jsonl"
    ),
    topic: CloudTopic = None,
    imu: ImuTopic = None,
    belts: BeltTopic = None,
    base_frame: BaseFrame = None,
    front: FrontJoints = None,
    rear: RearJoints = None,
    signs: AngleSigns = None,
    as_json: options.AsJson = False,
) -> None:
    """Run an exported policy on what a robot recorded, and log what it would have done.

    Nothing moves: POLICY is stepped as on the robot (flipperctl.runtime.FlipperController) with the
    messages of BAG in their order. The log has a line of JSON for each decision and each change of
    state. It has time, proposed targets and setpoints, whether the belts might run, state, fault
    and reason, and the angles that were measured.

    OVERRIDES are the robot's devices, as in devices=mine.yaml, or its widths and errors, as in
    perception.overall_width=0.6. Without devices, those in POLICY count.

    [bold]Examples[/]

      flipperctl robot shadow stair.onnx recorded_bag --output shadow.jsonl

      flipperctl robot shadow stair.onnx run.mcap perception.pose=matched
    """
    from flipperctl.ros.recording import LOG, check_used, shadow
    from flipperctl.ros.topics import Names
    from flipperctl.runtime.policy import OnnxPolicy
    from flipperctl.terminal.tables import print_shadow
    from flipperctl.text.files import check_output

    check_output(output, LOG)
    config, pose, keys, devices = recorded_robot(overrides, OnnxPolicy(policy).interface.devices)
    check_used(keys)
    joints = {"front": front or None, "rear": rear or None, "signs": signs and signs.value}
    names = Names.of(devices, clouds=topic, imu=imu, belts=belts, base=base_frame, **joints)
    document = shadow(policy, bag, config.perception, pose, names, output, devices.limits)
    show(document, lambda: print_shadow(document), as_json=as_json)


def ground(
    source: Annotated[Path, typer.Argument(help="A bag, or a folder of clouds and poses.txt.")],
    output: Annotated[Path, typer.Option(metavar="FILE.xyz", help="The file to write.")],
    overrides: options.Overrides = None,
    topic: CloudTopic = None,
    fixed_frame: FixedFrame = None,
    base_frame: BaseFrame = None,
    reach: Annotated[
        float,
        typer.Option(metavar="X", min=0.5, help="Distance in m beyond which points are left out."),
    ] = 5.0,
    cell: Annotated[
        float,
        typer.Option(
            metavar="X", min=0.005, max=0.2, help="One point is kept in a cube of this edge in m."
        ),
    ] = 0.02,
    as_json: options.AsJson = False,
) -> None:
    """Make recorded ground from a bag of ROS 1 or 2, or from a folder of clouds with poses.

    The points of all clouds are put into one frame by the recorded transforms or odometry, without
    the robot's own, and thinned. The command prints how to drive over them
    (terrain=profile_file). A folder has clouds (.pcd, .ply, .xyz, .npy) in the frame of the
    chassis, and poses.txt with a line for each. A line has 8 numbers (stamp, x, y, z, qx, qy, qz,
    qw), or 12 (the rows of [[R|t]]).

    OVERRIDES are the robot that recorded, as in robot=absolem, whose own points are left out.

    [bold]Examples[/]

      flipperctl robot ground recorded_bag --output ground.xyz

      flipperctl robot ground run.mcap --output ground.xyz --fixed-frame map
    """
    from flipperctl.api import Robot
    from flipperctl.export.policy import robot_fields
    from flipperctl.requests.text import from_words
    from flipperctl.ros.ground import convert
    from flipperctl.ros.topics import Names
    from flipperctl.runtime.devices import Devices
    from flipperctl.terminal.tables import print_ground

    typed = from_words(overrides or ())
    robot = Robot(**robot_fields(typed.without_devices.values(), "robot ground"))
    devices = typed.devices() or Devices()
    names = Names.of(devices, clouds=topic, fixed=fixed_frame, base=base_frame)
    document = convert(source, output, robot, names, reach, cell)
    show(document, lambda: print_ground(document), as_json=as_json)


def drive(
    bag: Annotated[Path, typer.Argument(help="A bag of ROS 1 or 2 in which an operator drove.")],
    outcome: Annotated[
        Ended, typer.Option(metavar="OUTCOME", help="How it ended: reached, overturned or stuck.")
    ],
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the drives; drives/NAME.")
    ] = None,
    person: Annotated[str, typer.Option("--as", metavar="NAME", help="Who drove.")] = "me",
    as_json: options.AsJson = False,
) -> None:
    """Make the record of an operator's drive on a real robot, from which a policy learns.

    BAG has clouds, an Imu, the flippers' joints and the speed of the belts, and /diagnostics of our
    node if only the operator's part shall count. The file has what the robot's map showed at each
    decision, and the action that came closest to how the flippers turned. The table has what can be
    measured without knowing the ground. A field drive has no rewards, and no simulation can play
    it; flipperctl robot ground makes terrain of the same bag, to try policies on.

    OVERRIDES are the robot, its devices and the estimator, as in robot=mine.yaml.

    [bold]Examples[/]

      flipperctl robot drive recorded_bag --outcome reached --as anna

      flipperctl robot drive run.mcap robot=mine.yaml --outcome stuck --json
    """
    from flipperctl.api import Outcome
    from flipperctl.ros.field import field_drive
    from flipperctl.ros.topics import Names
    from flipperctl.terminal.tables import print_field_drive

    config, _, _, devices = recorded_robot(overrides)
    folder = output or Path("drives") / person
    driver = f"person: {person}"
    document = field_drive(bag, config, Names.of(devices), folder, driver, Outcome(outcome.value))
    show(document, lambda: print_field_drive(document), as_json=as_json)


def identify(
    bag: Annotated[Path, typer.Argument(help="A bag of ROS 1 or 2 of a robot that was driven.")],
    overrides: options.Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="The robot's file to write.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Estimate a robot's speeds, delay, torque and friction from a recorded drive.

    BAG has the flippers' joints and commands, an Imu, the robot's poses and the speed of its belts.
    Each value has an interval of 95 %, or a sentence on the drive that would tell it
    (docs/robot.md has the drive that tells all). The file has the values and their intervals; train
    and eval take it as robot=FILE.

    OVERRIDES are the robot's measures and masses, and its devices, as in robot=mine.yaml.

    [bold]Examples[/]

      flipperctl robot identify recorded_bag --output identified.yaml

      flipperctl robot identify run.mcap robot=mine.yaml devices=mine.yaml --json
    """
    from flipperctl.ros.identify import FILE, identify
    from flipperctl.terminal.tables import print_identified
    from flipperctl.text.files import check_output

    if output is not None:
        check_output(output, FILE)
    config, _, _, devices = recorded_robot(overrides)
    document = identify(bag, config.robot, devices, output)
    show(document, lambda: print_identified(document), as_json=as_json)


def self_test(
    messages: Annotated[str, typer.Argument(help="Lines of JSON, or - for a pipe.")],
    overrides: options.Overrides = None,
    signs: Annotated[
        Convention | None,
        typer.Option(
            metavar="NAME",
            help="Signs of the messages; flipperctl if not given.",
            show_default=False,
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> int:
    """Find wrong signs on a robot: move each part when told, and see how it was measured.

    MESSAGES is a file of JSON lines with what the robot's devices measure, or - for a pipe. Each
    sign that is wrong is named with what to set. Exit code 0: every motion was measured with the
    right sign.

    OVERRIDES are the robot's devices, as in devices=mine.yaml, in place of --signs. The messages
    then have the numbers of the robot's topics.

    The robot's own computer needs only numpy and onnxruntime for the same test: python -m
    flipperctl.runtime --self-test MESSAGES.

    [bold]Examples[/]

      flipperctl robot self-test messages.jsonl --signs rep103

      my_driver | flipperctl robot self-test - --signs rep103
    """
    from dataclasses import asdict

    from flipperctl.errors import RequestError
    from flipperctl.requests.text import from_words
    from flipperctl.runtime.recordings import opened, setup_by
    from flipperctl.runtime.recordings import self_test as tested

    typed = from_words(overrides or ())
    devices, other = typed.devices(), [r.text for r in typed if r.key not in ("devices", "robot")]
    both = devices is not None and signs is not None
    if other or both or (overrides and devices is None):
        word = f"--signs {signs}" if both else (other or overrides or [""])[0]
        raise RequestError(f"{word}: a file with devices, or --signs, is allowed")
    # The runtime's own test, with its verdicts as a document
    setup = setup_by(devices, (signs or Convention.flipperctl).value)
    test = tested(*opened(messages), setup, devices)  # it prints what to do meanwhile
    verdicts = [asdict(verdict) for verdict in test.verdicts]
    document = {"passed": test.passed, "verdicts": verdicts, "refused": test.refused}
    show(document, lambda: None, as_json=as_json)
    return 0 if test.passed else 1


def simulate(
    overrides: options.Overrides = None,
    seed: options.Seed = None,
    episodes: Annotated[int, typer.Option(metavar="N", min=1, help="Number of episodes.")] = 1,
    rate: Annotated[
        float, typer.Option(metavar="R", min=0.01, help="Simulated seconds in a real one.")
    ] = 1.0,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Wait for the node's answer to each sample.")
    ] = False,
    sim_time: Annotated[
        bool, typer.Option("--sim-time", help="Stamps of the simulator, for use_sim_time.")
    ] = False,
    delay: Annotated[
        float, typer.Option(metavar="S", min=0, max=5, help="Delay of all messages in s.")
    ] = 0.0,
    jitter: Annotated[
        float, typer.Option(metavar="S", min=0, max=5, help="Largest further delay in s.")
    ] = 0.0,
    loss: Annotated[
        float, typer.Option(metavar="P", min=0, max=0.9, help="Share of lost messages.")
    ] = 0.0,
    clock_step: Annotated[
        str | None,
        typer.Option(metavar="AT:S", help="The clock steps by S seconds at AT s of an episode."),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Put a simulated robot on topics of ROS 2, to try a node before the robot.

    Its LiDAR, inertial unit, encoders and belts publish as drivers do; its motors obey the joint
    commands of any node and stand without one. OVERRIDES are as of eval, and the robot's devices:
    names of topics, joints and frames, signs, place of the LiDAR.

    It needs rclpy, as of a sourced ROS 2, or else the extra dds.

    [bold]Examples[/]

      flipperctl robot simulate terrain=paper_step sim=mujoco --episodes 3

      flipperctl robot simulate terrain=stair robot=mine.yaml devices=mine.yaml

      flipperctl robot simulate terrain=step --lockstep --json
    """
    from flipperctl.config.words import with_flags
    from flipperctl.ros.simulate import Link, step_of
    from flipperctl.ros.simulate import simulate as simulated
    from flipperctl.runtime.devices import Devices
    from flipperctl.terminal.streams import print_note
    from flipperctl.terminal.tables import print_simulated

    link = Link(rate, lockstep, sim_time, delay, jitter, loss, step_of(clock_step))
    words = with_flags(list(overrides or ()), seed=seed)
    config, *_, devices = recorded_robot(words, Devices())
    rows = []
    for row in simulated(config, devices, link, episodes, print_note):
        print_note(f"episode {row['episode']}: {row['outcome']}, {row['seconds']:.1f} s")
        rows.append(row)
    show({"episodes": rows}, lambda: print_simulated(rows), as_json=as_json)
