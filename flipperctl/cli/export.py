"""``flipperctl export``."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

HELP = """Write a policy for the robot: [bold]onnx[/], or [bold]pt2[/] (torch.export); a scene for
other simulators: [bold]mjcf[/], [bold]urdf[/]; an episode as a bag of ROS 2: [bold]mcap[/].

Before a policy is saved, it is compared with torch on at least 1,000 observations of real rollouts;
a mismatch is an error. OVERRIDES are then the robot, as in robot.angle_limit=0.9, if it is another
than that of the training; the command prints the changes.

A scene or an episode is the first one of eval with the same OVERRIDES, checkpoint and seed.

[bold]Examples[/]

  flipperctl export onnx --checkpoint runs/first --output stair.onnx

  flipperctl export pt2 --checkpoint best.safetensors

  flipperctl export onnx --checkpoint generalist robot.flipper_speed=0.5

  flipperctl export urdf terrain=stair robot=absolem --output absolem.urdf

  flipperctl export mcap --controller okada sim=mujoco perception=lidar
"""


class Kind(StrEnum):
    """File formats of an exported policy, scene or episode."""

    onnx = "onnx"
    pt2 = "pt2"
    mjcf = "mjcf"
    urdf = "urdf"
    mcap = "mcap"


def run(
    kind: Annotated[Kind, typer.Argument(help="The format.")],
    checkpoint: options.CheckpointFile = None,
    overrides: options.Overrides = None,
    controller: options.DefaultOkada = None,
    seed: options.Seed = None,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="[<terrain>.<format>]; mcap: a folder.", show_default=False
        ),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    if kind in (Kind.onnx, Kind.pt2):
        if controller is not None or seed is not None:
            raise RequestError(f"--controller and --seed are for mjcf, urdf and mcap, not {kind}")
        if checkpoint is None:
            given = [word for word in overrides or [] if "=" not in word]
            hint = f"; write --checkpoint {given[0]}" if given else ""
            raise RequestError(f"{kind}: --checkpoint RUN_OR_FILE is missing{hint}")
        _policy(kind, checkpoint, overrides or [], output, as_json=as_json)
        return
    from flipperctl.cli.hydra.compose import only_one
    from flipperctl.cli.plan import scenes
    from flipperctl.config.words import with_engine, with_flags
    from flipperctl.evaluation.policies import controller_or_okada
    from flipperctl.export.scene import export_scene
    from flipperctl.ros.episode import export_bag
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_bag, print_scene

    words = with_flags(overrides, seed=seed)
    named = controller_or_okada(checkpoint, controller)
    if kind is Kind.mcap:
        config, source = only_one(scenes(words, checkpoint, named))
        folder = output or Path(config.terrain.plugin_name)
        bag = export_bag(config, source, folder)
        show(bag, lambda: print_bag(bag), as_json=as_json)
        return
    config, _ = only_one(scenes(with_engine(words), checkpoint, named))
    suffix = ".xml" if kind is Kind.mjcf else ".urdf"
    target = output or Path(f"{config.terrain.plugin_name}{suffix}")
    scene = export_scene(config, "mjcf" if kind is Kind.mjcf else "urdf", target)
    show(scene, lambda: print_scene(scene), as_json=as_json)


def _policy(
    kind: Kind, checkpoint: Path, words: list[str], output: Path | None, *, as_json: bool
) -> None:
    from flipperctl import checkpoint as checkpoints
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.export.policy import KINDS, export, robot_fields
    from flipperctl.files import check_output
    from flipperctl.policies.source import load_policy
    from flipperctl.terminal.streams import print_note, show
    from flipperctl.terminal.tables import print_export

    source = load_policy(checkpoint, takes="checkpoint", tell=print_note)
    saved = checkpoints.read(source.file)
    shipped = source.label() in checkpoints.shipped_policies()
    name = source.label() if shipped else saved.config().terrain.plugin_name
    target = output or Path(f"{name}.{kind.value}")
    check_output(target, KINDS[kind.value])
    robot = robot_fields(Overrides.parse(words).values())
    print(f"exporting {saved.path} and comparing it with torch …", file=sys.stderr, flush=True)
    found = export(saved, "onnx" if kind is Kind.onnx else "pt2", target, robot)
    show(found, lambda: print_export(target, saved.path, found), as_json=as_json)
