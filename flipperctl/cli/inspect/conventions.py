"""``flipperctl inspect conventions``: signs, frames, units and timing of engines and policies."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths
from flipperctl.errors import FlipperctlError, RequestError

if TYPE_CHECKING:
    from flipperctl.studies.conventions import Probe

HELP = """Probe signs, frames, units and timing of both engines, of sensing and of an exported file.

Each engine drives on the level, turns each pair of flippers up and presses it down, and drives up
a ramp; the sensor looks at a step. With an exported file, robot and observation are the file's, and
its actions, targets and period are compared with the robot (after robot.… overrides: with yours).
What differs from the contract is listed, and the command fails. sim=… names the engine beside the
default one.

[bold]Examples[/]

  flipperctl inspect conventions

  flipperctl inspect conventions sim=mujoco sim.substep=0.0025 --json

  flipperctl inspect conventions --checkpoint policy.onnx
"""


def run(
    overrides: Overrides = None,
    checkpoint: Annotated[
        Path | None, typer.Option(metavar="FILE", help="An exported .onnx file.")
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.terminal.conventions import print_probes

    found = _probes(list(overrides or []), checkpoint)
    wrong = [probe for probe in found if not probe.holds]
    if as_json:
        document = {"holds": not wrong, "probes": [probe.container() for probe in found]}
        print(json.dumps(document, indent=2))
    else:
        print_probes(found)
    if wrong:
        first = wrong[0]
        raise FlipperctlError(
            f"{len(wrong)} of {len(found)} conventions do not hold, first {first.of}: "
            f"{first.meaning} is {first.found:.3f} {first.unit}; {first.expected:.3f} ± "
            f"{first.tolerance:.3f} is allowed"
        )


def _probes(overrides: list[str], file: Path | None) -> list[Probe]:
    from flipperctl.cli.hydra import config_store
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.cli.scenes import with_engine
    from flipperctl.policies.exported import ExportedPolicy, exported_config, is_exported
    from flipperctl.studies.conventions import probe_export, probe_sensing, probe_world
    from flipperctl.studies.engines import in_default_engine

    if file is not None and not is_exported(file):
        raise RequestError(f"--checkpoint: an exported .onnx file is allowed; got {file}")
    config_store.register_defaults()
    primary = config_store.EVAL_CONTROLLER
    if file is not None:
        own = exported_config(file)
        primary = config_store.register_robot(own.robot, own.perception.layout)
    config = compose_environment(Overrides.parse(with_engine(overrides)), primary)
    plane = in_default_engine(config)
    found = [*probe_world(plane), *probe_world(config), *probe_sensing(config)]
    if file is not None:
        found += probe_export(ExportedPolicy(file).interface, config.robot, str(file))
    return found
