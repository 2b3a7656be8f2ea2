"""Export of a policy: build the file, compare it with torch, and only then write it.

In: a checkpoint and changes to its robot. Out: an ONNX or pt2 file, and the result of the
comparison on the observations of real rollouts.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.api import Robot
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, to_dict, with_overrides
from flipperctl.config.identity import differences
from flipperctl.config.robots import named_robot
from flipperctl.errors import ConfigError, ExportError
from flipperctl.export.onnx import export_onnx, folded, policy_metadata, with_risk
from flipperctl.export.parity import Outputs, compare, rollout_observations
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.guard import naming
from flipperctl.policies.trained import policy_module, policy_risk
from flipperctl.runtime.session import CHECKSUM, PLACEHOLDER, add_checksum


def export_pt2(
    module: torch.nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, Outputs]:
    """Return the bytes of the archive, and a function that computes its outputs."""
    example = torch.zeros(2, input_size(config.network, config.perception))
    program = torch.export.export(
        module, (example,), dynamic_shapes=({0: torch.export.Dim("batch")},)
    )
    buffer = io.BytesIO()
    torch.export.save(program, buffer, extra_files=dict(metadata))
    buffer.seek(0)
    # Read back what the file will hold; the bytes come from this process, so loading is safe.
    exported = torch.export.load(buffer).module()

    def outputs(observations: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        with torch.inference_mode():
            found = exported(torch.from_numpy(observations))
        tensors = found if isinstance(found, tuple) else (found,)
        return tuple(tensor.numpy() for tensor in tensors)

    return buffer.getvalue(), outputs


Format = Literal["onnx", "pt2"]
_MARK = re.compile(rb"flipperctl\.format_version")
KINDS: dict[str, OutputKind] = {
    "onnx": OutputKind("an exported policy", (".onnx",), _MARK),
    "pt2": OutputKind("an exported policy", (".pt2",), _MARK),
}
"""The file of each format."""
OBSERVATIONS = 1000
"""Smallest number of observations in the comparison."""


def export(
    checkpoint: Checkpoint,
    format: Format,
    output: Path,
    robot: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write the policy to ``output`` and return the result of the comparison.

    ``robot``: fields of the file's robot that differ from the training's.

    Raises:
        ConfigError: there is no such field, or its value is of the wrong type or out of bounds.
        MissingExtraError: the format is ONNX and a package that it needs is not installed.
        ExportError: the exported policy disagrees with torch; nothing is written.
        OutputError: the file cannot be written, see ``check_output``.
    """
    check_output(output, KINDS[format])
    trained = checkpoint.config()
    changes = {f"robot.{name}": value for name, value in (robot or {}).items()}
    config = with_overrides(trained, changes)
    module, risk = policy_module(checkpoint), policy_risk(checkpoint)
    observations = rollout_observations(config, module, OBSERVATIONS)
    metadata = policy_metadata(config, None if risk is None else risk.sign)
    # The exporters run the network's code and wrap its errors.
    with naming(config.network, "forward", ExportError, while_=" (export)"):
        if format == "onnx":
            metadata = {**metadata, CHECKSUM: PLACEHOLDER}
            data, outputs = export_onnx(with_risk(folded(module), risk), config, metadata)
            data = add_checksum(data)
        else:
            data, outputs = export_pt2(with_risk(folded(module), risk), config, metadata)
    found = compare(module, outputs, observations, risk)
    write_bytes(output, data)
    return {
        "format": format,
        "output": str(output),
        "bytes": len(data),
        **found,
        "robot_changes": _changes(config.robot, trained.robot),
    }


def robot_fields(changes: Mapping[str, Any], command: str = "export") -> dict[str, Any]:
    """Return the fields of the robot among changes of settings, by their paths.

    ``robot`` names a robot, which has all fields. ``command`` takes them, for the error.
    """
    own = dict(changes)
    chosen = {}
    if (name := own.pop("robot", None)) is not None:
        if not isinstance(name, str):
            raise ConfigError(f"robot: a name or a file is allowed; the value is {name!r}")
        chosen = dict(named_robot(name))
    for key in own:
        section, _, field = key.partition(".")
        if section != "robot" or not field:
            raise ConfigError(
                f"{key}: {command} takes settings of the robot alone, as in robot=absolem or "
                "robot.angle_limit=0.9; everything else is that of the "
                f"{'training' if command == 'export' else 'recording'}"
            )
    return chosen | {key.removeprefix("robot."): value for key, value in own.items()}


def _changes(ours: Robot, trained: Robot) -> dict[str, dict[str, float | None]]:
    """Return the differences of two robots, with the decision period for control_period."""
    here, there = (
        {**to_dict(robot), "control_period": None, "decision_period": robot.decision_period}
        for robot in (ours, trained)
    )
    return {name: {"training": b, "file": a} for name, a, b in differences(here, there)}
