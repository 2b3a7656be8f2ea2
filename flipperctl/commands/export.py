"""``flipperctl export``: a policy, a scene or an episode as a file for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note, show


class Kind(StrEnum):
    """File formats of an exported policy, scene or episode."""

    onnx = "onnx"
    mjcf = "mjcf"
    urdf = "urdf"
    mcap = "mcap"
    vectors = "vectors"


def export(
    kind: Annotated[Kind, typer.Argument(help="The format.")],
    words: Annotated[
        list[str] | None, typer.Argument(metavar="POLICY [SETTING...]", help="A policy; key=value.")
    ] = None,
    seed: options.Seed = None,
    episode: Annotated[int, typer.Option(metavar="N", min=0, help="Episode; mcap.")] = 0,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="[<terrain>.<format>]; mcap: a folder.", show_default=False
        ),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Write a policy for the robot, [bold]onnx[/]; a scene for other simulators, [bold]mjcf[/] or
    [bold]urdf[/]; an episode as a bag of ROS 2, [bold]mcap[/]; [bold]vectors[/] for a port.

    Before a policy is saved, it is compared with torch on at least 1,000 observations of real
    rollouts; a mismatch is an error. SETTINGS are then the robot, as in robot.angle_limit=0.9, if
    it is another than that of the training; the command prints the changes. The file of
    devices=FILE or robot=FILE gives the policy the robot's devices.

    A scene or an episode is the first one of eval with the same policy, by default okada, SETTINGS
    and seed. Vectors are 200 instants of an exported file as JSON, with which a port to another
    language is tested: what was measured, observation, Q-values, action and targets.

    [bold]Examples[/]

      flipperctl export onnx runs/first --output stair.onnx

      flipperctl export onnx generalist robot.flipper_speed=0.5

      flipperctl export onnx runs/first robot=mine.yaml devices=mine.yaml

      flipperctl export urdf terrain=stair robot=absolem --output absolem.urdf

      flipperctl export vectors stair.onnx terrain=stair --output stair.json

      flipperctl export mcap okada sim=mujoco perception=lidar
    """  # noqa: D205  # the summary, which help prints, has two lines
    from flipperctl.evaluation.plan import split_policies

    if kind is Kind.onnx:
        if seed is not None:
            raise RequestError(f"--seed is for mjcf, urdf and mcap, not {kind}")
        names, settings = split_policies(words)
        if len(names) != 1:
            raise RequestError(f"{kind}: name a policy, as in: flipperctl export {kind} runs/first")
        _export_policy(Path(names[0]), settings, output, as_json=as_json)
        return
    from flipperctl.cli.plan import one_scene
    from flipperctl.config.words import with_engine, with_flags
    from flipperctl.export.scene import export_scene
    from flipperctl.export.vectors import export_vectors
    from flipperctl.requests.text import from_words
    from flipperctl.ros.episode import export_bag
    from flipperctl.terminal.tables import print_bag, print_scene, print_vectors

    words = with_flags(words, seed=seed)
    if kind in (Kind.mjcf, Kind.urdf):
        words = with_engine(words)
    if not split_policies(words)[0]:
        words = ["okada", *words]
    entry = one_scene(words, f"export {kind}")
    config, source = entry.config, entry.source
    name = config.terrain.plugin_name
    if kind is Kind.vectors:
        written = export_vectors(config, source, output or Path(f"{name}.json"))
        show(written, lambda: print_vectors(written), as_json=as_json)
        return
    if kind is Kind.mcap:
        devices = from_words(split_policies(words)[1]).devices()
        bag = export_bag(config, source, output or Path(name), episode, devices)
        show(bag, lambda: print_bag(bag), as_json=as_json)
        return
    target = output or Path(f"{name}.xml" if kind is Kind.mjcf else f"{name}.urdf")
    scene = export_scene(config, "mjcf" if kind is Kind.mjcf else "urdf", target)
    show(scene, lambda: print_scene(scene), as_json=as_json)


def _export_policy(
    checkpoint: Path, words: list[str], output: Path | None, *, as_json: bool
) -> None:
    from flipperctl import checkpoint as checkpoints
    from flipperctl.export.policy import FILE, export, robot_fields
    from flipperctl.policies.source import load_policy
    from flipperctl.requests.text import from_words
    from flipperctl.terminal.tables import print_export
    from flipperctl.text.files import check_output

    source = load_policy(checkpoint, takes="checkpoint", tell=print_note)
    saved = checkpoints.read(source.file)
    shipped = source.label() in checkpoints.shipped_policies()
    trained = saved.policy_config(on_its_terrain=True)
    name = source.label() if shipped else trained.terrain.plugin_name
    target = output or Path(f"{name}.onnx")
    check_output(target, FILE)
    typed = from_words(words)
    robot = robot_fields(typed.without_devices.values())
    print_note(f"exporting {saved.path} and comparing it with torch …")
    exported = export(saved, target, robot, typed.devices())
    show(exported, lambda: print_export(target, saved.path, exported), as_json=as_json)
