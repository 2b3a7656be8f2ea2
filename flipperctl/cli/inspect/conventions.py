"""``flipperctl inspect conventions``: signs, frames, units and timing of engines and policies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.evaluation.conventions import Probe

HELP = """Probe signs, frames, units and timing of two engines, of sensing and of an exported file.

In each engine the robot drives on level ground, raises and lowers each pair of flippers, and drives
up a ramp; the sensor measures a step. With an exported file, robot and observation are the file's;
its actions, targets and period are compared with that robot, or with yours after robot.… overrides.
Differences from the contract are listed, and then the command fails. sim=… names the engine that is
probed beside the default one.

[bold]Examples[/]

  flipperctl inspect conventions

  flipperctl inspect conventions sim=mujoco sim.substep=0.0025 --json

  flipperctl inspect conventions --checkpoint policy.onnx
"""


def run(
    overrides: options.Overrides = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="FILE", help="An exported .onnx file.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.evaluation.conventions import require_conventions
    from flipperctl.terminal.conventions import print_probes
    from flipperctl.terminal.streams import show

    found = _probes(list(overrides or []), checkpoint)
    holds = all(probe.holds for probe in found)
    document = {"holds": holds, "probes": [probe.to_dict() for probe in found]}
    show(document, lambda: print_probes(found), as_json=as_json)
    require_conventions(found)


def _probes(overrides: list[str], file: Path | None) -> list[Probe]:
    from flipperctl.cli.hydra import config_store
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config.words import with_engine
    from flipperctl.evaluation.conventions import probe
    from flipperctl.policies.exported import exported_config, is_exported

    if file is not None and not is_exported(file):
        raise RequestError(f"--checkpoint: only an exported .onnx file is allowed; got {file}")
    primary = config_store.EVAL_CONTROLLER
    if file is not None:
        own = exported_config(file)
        primary = config_store.register_robot(own.robot, own.perception.layout)
    config = compose_environment(Overrides.parse(with_engine(overrides)), primary)
    return probe(config, file)
