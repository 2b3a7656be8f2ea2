"""Export of a policy: build the file, compare it with torch, and only then write it.

In: a checkpoint and changes to its robot. Out: an ONNX file, and the result of the
comparison on the observations of real rollouts. The network in the file has fewer layers and equal
results, and two further outputs if the policy has a risk. Strings under ``flipperctl.*`` hold all
that a robot needs to run it.
"""

from __future__ import annotations

import copy
import importlib
import json
import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from flipperctl.agent.frames import input_size, stacked
from flipperctl.agent.networks import outputs as outputs_of
from flipperctl.agent.risk import Risk
from flipperctl.api import Perception, Robot
from flipperctl.checkpoint import Checkpoint, plugin_references
from flipperctl.config import EnvConfig, TrainConfig, to_dict, with_overrides
from flipperctl.config.identity import differences
from flipperctl.config.resolver import named_robot
from flipperctl.core.targets import Action, ActionKind
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import (
    ConfigError,
    ExportError,
    FlipperctlError,
    RequestError,
    missing_extra,
)
from flipperctl.export.metadata import policy_metadata
from flipperctl.plugging.guard import naming
from flipperctl.policies.acting import TrainedPolicy
from flipperctl.policies.trained import policy_module, policy_risk
from flipperctl.rollout.episode import EvaluationSeeds, play
from flipperctl.runtime.devices import SECTION, Devices
from flipperctl.runtime.interface import (
    CHECKSUM,
    OUTPUTS,
    PLACEHOLDER,
    PREFIX,
    add_checksum,
)
from flipperctl.text.files import OutputKind, check_output, write_bytes

FILE = OutputKind("an exported policy", (".onnx",), re.compile(rb"flipperctl\.format_version"))
OBSERVATIONS = 1000
"""Smallest number of observations in the comparison."""
TOLERANCE = 1e-4
"""Largest difference of outputs that counts as rounding, relative to the largest absolute one."""
OPSET = 18

Outputs = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], ...]]
"""Maps inputs of the network (M, F · n) to Q-values (M, 9), and if it has a risk, to what the
network of the risk returns."""


def export(
    checkpoint: Checkpoint,
    output: Path,
    robot: Mapping[str, Any] | None = None,
    devices: Devices | None = None,
) -> dict[str, Any]:
    """Write the policy to ``output`` and return the result of the comparison.

    ``robot``: fields of the file's robot that differ from the training's; ``devices``: its own.

    Raises:
        ConfigError: there is no such field, or its value is of the wrong type or out of bounds.
        MissingExtraError: a package that ONNX needs is not installed.
        ExportError: the exported policy disagrees with torch; nothing is written.
        OutputError: the file cannot be written, see ``check_output``.
    """
    check_output(output, FILE)
    # The file is for this robot, which may differ from the training's.
    trained = checkpoint.policy_config(on_its_terrain=True)
    changes = {f"robot.{name}": value for name, value in (robot or {}).items()}
    config = with_overrides(trained, changes)
    module, risk = policy_module(checkpoint), policy_risk(checkpoint)
    # Compared on observations of the policy's own episodes, with the robot of the file.
    observations = rollout_observations(config, module, OBSERVATIONS)
    sign = None if risk is None else risk.sign
    metadata = policy_metadata(config, checkpoint.document.plugins, sign)
    if devices is not None:
        metadata[f"{PREFIX}{SECTION}"] = json.dumps(devices.to_json())
    # The exporter runs the network's code and wraps its errors.
    with naming(config.network, "forward", ExportError, while_=" (export)"):
        network = folded(module)
        if risk is not None:
            network = PolicyWithRisk(network, risk).eval()
        data, outputs = export_onnx(network, config, {**metadata, CHECKSUM: PLACEHOLDER})
    result = compare(module, outputs, observations, risk, config.actions)
    write_bytes(output, data := add_checksum(data))
    return {
        "format": "onnx",
        "output": str(output),
        "bytes": len(data),
        **result,
        "robot_changes": _changes(config.robot, trained.robot),
    }


def save_network(
    network: nn.Module, env: EnvConfig, output: Path, seed: int, kind: ActionKind = "turns"
) -> dict[str, Any]:
    """Write a module of any origin as an ONNX policy; return the result of the comparison.

    ``network``: observations (B, n) in SI units → (B, 9), whose largest number is the action, or
    with ``kind="rates"`` rates from -1 to 1, (B, 2). ``env``: the environment in which it was
    trained. ``seed``: the seed of the training.

    Raises:
        RequestError: the module takes or returns other numbers.
        ExportError: torch cannot export it, or the file disagrees with torch; nothing is written.
        OutputError: the file cannot be written, see ``check_output``.
    """
    if not isinstance(network, nn.Module):
        raise RequestError(
            f"network: a module of torch is allowed, not a {type(network).__name__}; "
            "docs/own_method.md shows which part of a model of Stable-Baselines3 is one"
        )
    # A module of any origin has no training: the configuration states what a robot needs.
    check_output(output, FILE)
    sections = {name: getattr(env, name) for name in EnvConfig.model_fields if name != "rewards"}
    config = TrainConfig(network={"name": "mlp"}, actions=kind, seed=seed, **sections)
    module = copy.deepcopy(network).cpu().eval()
    # Try the module on two observations before anything costs time.
    size = config.perception.layout.size
    try:
        with torch.inference_mode():
            returned = module(torch.zeros(2, size))
    except (RuntimeError, TypeError, AttributeError, ValueError) as error:
        raise RequestError(
            f"network: it does not take observations (B, {size}): {error}"
        ) from error
    shape = tuple(getattr(returned, "shape", ()))
    returns = f"the shape {shape}" if shape else f"a {type(returned).__name__}"
    joints = len(config.robot.joints)
    if shape != (2, count := outputs_of(kind, joints)):
        other: ActionKind = "rates" if kind == "turns" else "turns"
        hint = f"; environment(actions={other!r}) has such actions"
        raise RequestError(
            f"network: it returns {returns} for (2, {size}); (2, {count}) is allowed"
            f"{hint if shape == (2, outputs_of(other, joints)) else ''}"
        )
    metadata = policy_metadata(config, plugin_references(config))
    metadata |= {f"{PREFIX}network": type(network).__name__}
    data, outputs = _as_onnx(module, config, {**metadata, CHECKSUM: PLACEHOLDER})
    observations = rollout_observations(config, module, OBSERVATIONS)
    # Real inputs show what zeros do not: a module need not end in Tanh.
    if kind == "rates" and (largest := float(np.abs(outputs(observations)[0]).max())) > 1:
        raise RequestError(
            f"network: it returns {largest:.3g} in its own episodes; rates from -1 to 1 are "
            "allowed, as those of a last layer torch.nn.Tanh()"
        )
    compared = compare(module, outputs, observations, kind=kind)
    write_bytes(output, add_checksum(data))
    return compared


def robot_fields(changes: Mapping[str, Any], command: str = "export") -> dict[str, Any]:
    """Return the fields of the robot among changes of settings, by their paths.

    ``robot`` names a robot, which has all fields. ``command`` takes them, for the error.
    """
    fields = dict(changes)
    preset = {}
    # A named robot gives all fields; single fields replace some of them.
    if (name := fields.pop("robot", None)) is not None:
        if not isinstance(name, str):
            raise ConfigError(f"robot: a name or a file is allowed; the value is {name!r}")
        preset = dict(named_robot(name))
    for key in fields:
        section, _, field = key.partition(".")
        if section != "robot" or not field:
            raise ConfigError(
                f"{key}: {command} takes settings of the robot alone, as in robot=absolem or "
                "robot.angle_limit=0.9; everything else is that of the "
                f"{'training' if command == 'export' else 'recording'}"
            )
    return preset | {key.removeprefix("robot."): value for key, value in fields.items()}


def _changes(exported: Robot, trained: Robot) -> dict[str, dict[str, float | None]]:
    """Return the differences of two robots, with the decision period for control_period."""
    here, there = (
        {**to_dict(robot), "control_period": None, "decision_period": robot.decision_period}
        for robot in (exported, trained)
    )
    return {name: {"training": b, "file": a} for name, a, b in differences(here, there)}


def folded(network: nn.Module) -> nn.Module:
    """Return a copy of ``network`` in evaluation mode, with all foldable modules folded."""
    module: nn.Module = _fold(copy.deepcopy(network)).eval()
    return module


def _fold(module: nn.Module) -> Any:
    if callable(fold := getattr(module, "folded", None)):
        return fold()
    for name, child in module.named_children():
        setattr(module, name, _fold(child))
    return _join(list(module)) if type(module) is nn.Sequential else module


def _join(parts: list[nn.Module]) -> nn.Module:
    """Return the parts in sequence, each joined to the linear layer after it where possible."""
    for i in reversed(range(len(parts) - 1)):
        join, after = getattr(parts[i], "folded_into", None), parts[i + 1]
        if callable(join) and isinstance(after, nn.Linear):
            parts[i : i + 2] = [join(after)]
    return nn.Sequential(*parts)


class PolicyWithRisk(nn.Module):
    """Maps inputs (B, F · n) to Q-values (B, 9), risks (B, 1), coefficients (B, lags).

    The calibration is folded into the last layer, which becomes two, so that a
    decision computes no product, sum and slices for it.
    """

    def __init__(self, policy: nn.Module, risk: Risk) -> None:
        super().__init__()
        # σ(slope · (W·x + b) + shift), and slope · coefficients: both scales go into the weights.
        *hidden, last = risk.network.layers
        assert isinstance(last, nn.Linear)
        self.policy, self.hidden = policy, nn.Sequential(*hidden)
        weight, bias = risk.slope * last.weight, risk.slope * last.bias
        self.alone = _layer(weight[:1], bias[:1] + risk.shift)
        self.coefficients = _layer(weight[1:], bias[1:])

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the Q-values, the risk of the input alone, and what recurrence adds to it."""
        features = self.hidden(observation)
        alone = torch.sigmoid(self.alone(features))
        return self.policy(observation), alone, self.coefficients(features)


def _layer(weight: torch.Tensor, bias: torch.Tensor) -> nn.Linear:
    layer = nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight, "bias": bias})
    return layer.requires_grad_(False)


def export_onnx(
    module: nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, Outputs]:
    """Return the bytes of the model, and a function that computes its outputs."""
    onnx, runtime = (_import_package(name) for name in ("onnx", "onnxruntime"))
    _import_package("onnxscript")
    example = torch.zeros(2, input_size(config.network, config.perception))
    names = [OUTPUTS[config.actions]]
    if isinstance(module, PolicyWithRisk):
        names += ["risk", "risk_recurrence"]
    # The batch stays dynamic, so that the comparison runs in one call.
    with _silent_exporter():
        program = torch.onnx.export(
            module,
            (example,),
            input_names=["observation"],
            output_names=names,
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ExportError("torch returned no ONNX program")
    # Local paths do not belong into a file for others.
    model = program.model_proto
    graph = model.graph
    for part in (graph, *graph.node, *graph.value_info, *graph.input, *graph.output):
        del part.metadata_props[:]  # the exporter's notes contain stack traces with local paths
    # Older runtimes, as on a Jetson, refuse a newer version than the operators need.
    model.ir_version = onnx.helper.find_min_ir_version_for(model.opset_import, ignore_unknown=True)
    # Checked as a whole, then run by the runtime that robots use.
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString()
    session = runtime.InferenceSession(data, providers=["CPUExecutionProvider"])

    def outputs(observations: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        return tuple(session.run(names, {"observation": observations}))

    return data, outputs


@contextmanager
def _silent_exporter() -> Iterator[None]:
    """Suppress the exporter's notes on optional packages and its deprecation warnings."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            warnings.simplefilter("ignore", DeprecationWarning)
            yield
    finally:
        logger.setLevel(level)


def _import_package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_extra("export onnx", name) from error


class _RecordingPolicy(TrainedPolicy):
    """Acts like a trained policy and keeps the inputs of its network."""

    def __init__(self, module: nn.Module, config: TrainConfig) -> None:
        joints = len(config.robot.joints)
        super().__init__(module, config.network.frames, kind=config.actions, joints=joints)
        self.inputs: list[NDArray[np.float32]] = []

    def act(self, p: Perception) -> Action:
        self.inputs.append(stacked(p.recent, self.frames))
        return super().act(p)


def rollout_observations(config: TrainConfig, module: nn.Module, count: int) -> NDArray[np.float32]:
    """Return at least ``count`` network inputs from the policy's own episodes, (M, F · n)."""
    env = FlipperEnv(config=config.environment().model_copy(update={"rewards": {}}))
    policy = _RecordingPolicy(module, config)
    seeds, episode = EvaluationSeeds.of(config.seed, config.terrain), 0
    # Whole episodes, with the seeds of an evaluation, until there are enough.
    while len(policy.inputs) < count:
        play(env, policy, seeds(episode))
        episode += 1
    return np.stack(policy.inputs)


def compare(
    module: nn.Module,
    exported: Outputs,
    observations: NDArray[np.float32],
    risk: nn.Module | None = None,
    kind: ActionKind = "turns",
) -> dict[str, Any]:
    """Return the largest difference of the outputs and the agreement of the chosen actions.

    ``risk``: the network of the risk, if it was exported too; the result then has the largest
    difference of the risks.
    """
    # torch on the same inputs is the reference.
    with torch.inference_mode():
        expected = module(torch.from_numpy(observations)).numpy()  # (M, 9)
        risks = risk(torch.from_numpy(observations)) if risk is not None else ()
    actual, *others = exported(observations)
    if actual.shape != expected.shape:
        raise ExportError(f"the exported policy returns {actual.shape}, torch {expected.shape}")
    difference, largest, limit = _difference([expected], [actual])
    # Actions must agree wherever two Q-values differ by more than rounding.
    agree = expected.argmax(1) == actual.argmax(1)
    if kind == "rates":
        agree = (np.abs(expected - actual) <= limit).all(axis=1)
    agreement = float(agree.mean())
    ordered = np.sort(expected, axis=1)
    decided = ordered[:, -1] - ordered[:, -2] > 2 * limit  # no tie within rounding
    differs = decided & ~agree
    if not difference <= limit or differs.any():
        raise ExportError(
            f"the exported policy disagrees with torch: Q-values differ by up to {difference:g} "
            f"(allowed {limit:g}), actions agree on {100 * agreement:.4g} % of {len(observations)} "
            "observations; nothing was written"
        )
    return {
        "observations": len(observations),
        "largest_difference": difference,
        "largest_q_value": largest,
        "allowed_difference": limit,
        "action_agreement": agreement,
        **({} if risk is None else _compared_risks([r.numpy() for r in risks], others)),
    }


def _difference(
    expected: list[NDArray[np.float32]], actual: list[NDArray[np.float32]]
) -> tuple[float, float, float]:
    """Return the largest difference, the largest absolute value and the allowed difference."""
    pairs = zip(expected, actual, strict=True)
    largest = max(float(np.abs(array).max()) for array in expected)
    difference = max(float(np.abs(wanted - computed).max()) for wanted, computed in pairs)
    return difference, largest, TOLERANCE * max(1.0, largest)


def _compared_risks(
    expected: list[NDArray[np.float32]], actual: list[NDArray[np.float32]]
) -> dict[str, float]:
    shapes, wanted = ([array.shape for array in arrays] for arrays in (actual, expected))
    if shapes != wanted:
        raise ExportError(f"the exported risk has the shapes {shapes}, torch {wanted}")
    difference, _, limit = _difference(expected, actual)
    if not difference <= limit:
        raise ExportError(
            f"the exported policy disagrees with torch: risks differ by up to {difference:g} "
            f"(allowed {limit:g}); nothing was written"
        )
    return {"largest_risk_difference": difference}


def compare_onnx(
    module: nn.Module, config: TrainConfig, observations: NDArray[np.float32]
) -> dict[str, Any]:
    """Export a network as ONNX without writing a file, and compare it with torch.

    Returns the result of ``compare``.
    """
    return compare(module, _as_onnx(module, config, {})[1], observations, kind=config.actions)


def _as_onnx(
    module: nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, Outputs]:
    """Return what ``export_onnx`` returns; ExportError if torch cannot export the module."""
    try:
        return export_onnx(folded(module), config, metadata)
    except FlipperctlError:
        raise
    except Exception as error:  # the exporter's errors have no common type
        cause: BaseException = error
        while cause.__cause__ is not None:  # around it are the exporter's advice and colours
            cause = cause.__cause__
        line, *_ = (*filter(None, map(str.strip, str(cause).splitlines())), repr(cause))
        raise ExportError(f"torch cannot export it as ONNX: {line}") from error
