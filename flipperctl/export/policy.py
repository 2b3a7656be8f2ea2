"""Export of a policy: build the file, compare it with torch, and only then write it.

In: a checkpoint and changes to its robot. Out: an ONNX or pt2 file, and the result of the
comparison on the observations of real rollouts.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size, stacked
from flipperctl.api import Perception, Robot
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, to_dict, with_overrides
from flipperctl.config.identity import differences
from flipperctl.config.robots import named_robot
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, ExportError, FlipperctlError
from flipperctl.export.onnx import Outputs, export_onnx, folded, policy_metadata, with_risk
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.guard import naming
from flipperctl.policies.trained import TrainedPolicy, policy_module, policy_risk
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import EvaluationSeeds
from flipperctl.runtime.interface import CHECKSUM, PLACEHOLDER, add_checksum


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


TOLERANCE = 1e-4
"""Largest difference of Q-values that counts as rounding, relative to the largest |Q|."""


class _RecordingPolicy(TrainedPolicy):
    """Acts like a trained policy and keeps the inputs of its network."""

    def __init__(self, module: torch.nn.Module, frames: int) -> None:
        super().__init__(module, frames)
        self.inputs: list[NDArray[np.float32]] = []

    def act(self, p: Perception) -> int:
        self.inputs.append(stacked(p.recent, self.frames))
        return super().act(p)


def rollout_observations(
    config: TrainConfig, module: torch.nn.Module, count: int
) -> NDArray[np.float32]:
    """Return at least ``count`` network inputs from the policy's own episodes, (M, F · (N + 3))."""
    env = FlipperEnv(config=config.environment())
    policy = _RecordingPolicy(module, config.network.frames)
    seeds, episode = EvaluationSeeds.of(config.seed, config.terrain), 0
    while len(policy.inputs) < count:
        play(env, policy, seeds(episode))
        episode += 1
    return np.stack(policy.inputs)


def compare(
    module: torch.nn.Module,
    exported: Outputs,
    observations: NDArray[np.float32],
    risk: torch.nn.Module | None = None,
) -> dict[str, Any]:
    """Return the largest difference of the Q-values and the agreement of the chosen actions.

    ``risk``: the network of the risk, if it was exported too; the result then has the largest
    difference of the risks.
    """
    with torch.inference_mode():
        expected = module(torch.from_numpy(observations)).numpy()  # (M, 9)
    actual, *others = exported(observations)
    if actual.shape != expected.shape:
        raise ExportError(f"the exported policy returns {actual.shape}, torch {expected.shape}")
    difference = float(np.abs(expected - actual).max())
    largest = float(np.abs(expected).max())
    limit = TOLERANCE * max(1.0, largest)
    agreement = float((expected.argmax(1) == actual.argmax(1)).mean())
    ordered = np.sort(expected, axis=1)
    decided = ordered[:, -1] - ordered[:, -2] > 2 * limit  # no tie within rounding
    differs = decided & (expected.argmax(1) != actual.argmax(1))
    if not difference <= limit or differs.any():
        raise ExportError(
            f"the exported policy disagrees with torch: Q-values differ by up to {difference:g} "
            f"(allowed {limit:g}), actions agree on {agreement:.2%} of {len(observations)} "
            "observations; nothing was written"
        )
    return {
        "observations": len(observations),
        "largest_difference": difference,
        "largest_q_value": largest,
        "allowed_difference": limit,
        "action_agreement": agreement,
        **({} if risk is None else _compared_risks(risk, others, observations)),
    }


def _compared_risks(
    risk: torch.nn.Module, others: Sequence[NDArray[np.float32]], observations: NDArray[np.float32]
) -> dict[str, float]:
    with torch.inference_mode():
        expected = [tensor.numpy() for tensor in risk(torch.from_numpy(observations))]
    shapes, wanted = ([array.shape for array in found] for found in (others, expected))
    if shapes != wanted:
        raise ExportError(f"the exported risk has the shapes {shapes}, torch {wanted}")
    both = list(zip(expected, others, strict=True))
    difference = max(float(np.abs(a - b).max()) for a, b in both)
    largest = max(float(np.abs(a).max()) for a in expected)
    limit = TOLERANCE * max(1.0, largest)
    if not difference <= limit:
        raise ExportError(
            f"the exported policy disagrees with torch: risks differ by up to {difference:g} "
            f"(allowed {limit:g}); nothing was written"
        )
    return {"largest_risk_difference": difference}


def compare_onnx(
    module: torch.nn.Module, config: TrainConfig, observations: NDArray[np.float32]
) -> dict[str, Any]:
    """Export a network as ONNX without writing a file, and compare it with torch.

    Returns the result of ``compare``.
    """
    try:
        _, outputs = export_onnx(folded(module), config, {})
    except FlipperctlError:
        raise
    except Exception as error:  # the exporter's errors have no common type
        raise ExportError(f"torch cannot export it as ONNX: {_first_line(error)}") from error
    return compare(module, outputs, observations)


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), repr(error))
