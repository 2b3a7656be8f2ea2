"""Export of a network as an ONNX model, with its metadata in the model.

In: a training configuration and its network. Out: a model with fewer layers, equal results and, if
the policy tells its risk, two further outputs; and all that a robot needs to run it, as strings
under ``flipperctl.*``.
"""

from __future__ import annotations

import copy
import importlib
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from flipperctl import __version__
from flipperctl.agent.frames import input_size
from flipperctl.agent.risk import Risk
from flipperctl.api import ObservationLayout
from flipperctl.checkpoint import plugin_references
from flipperctl.config import TrainConfig, resolver
from flipperctl.core import observation
from flipperctl.core.lidar.ground import MEANING as MEANING_OF_MAP
from flipperctl.core.risk import ESCAPE_MEANING as MEANING_OF_ESCAPE
from flipperctl.core.risk import LAGS, SCALE, RiskSign
from flipperctl.core.risk import MEANING as MEANING_OF_RISK
from flipperctl.core.targets import JOINTS, MEANING, turns
from flipperctl.errors import ExportError, MissingExtraError
from flipperctl.runtime.interface import FORMAT_VERSION, PREFIX
from flipperctl.sim.lidar import LidarSensor


def folded(network: nn.Module) -> nn.Module:
    """Return a copy of ``network`` in evaluation mode, with all foldable modules folded."""
    return _fold(copy.deepcopy(network)).eval()


def _fold(module: nn.Module) -> nn.Module:
    if callable(fold := getattr(module, "folded", None)):
        replacement: nn.Module = fold()
        return replacement
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


class PolicyWithRisk(torch.nn.Module):
    """Maps inputs (B, F · (N + 3)) to Q-values (B, 9), risks (B, 1), coefficients (B, lags).

    The calibration is folded into the last layer, which becomes two, so that a
    decision computes no product, sum and slices for it.
    """

    def __init__(self, policy: torch.nn.Module, risk: Risk) -> None:
        super().__init__()
        *hidden, last = risk.network.layers
        assert isinstance(last, torch.nn.Linear)
        self.policy, self.hidden = policy, torch.nn.Sequential(*hidden)
        weight, bias = risk.slope * last.weight, risk.slope * last.bias
        self.alone = _layer(weight[:1], bias[:1] + risk.shift)
        self.coefficients = _layer(weight[1:], bias[1:])

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the Q-values, the risk of the input alone, and what recurrence adds to it."""
        features = self.hidden(observation)
        alone = torch.sigmoid(self.alone(features))
        return self.policy(observation), alone, self.coefficients(features)


def _layer(weight: torch.Tensor, bias: torch.Tensor) -> torch.nn.Linear:
    layer = torch.nn.Linear(weight.shape[1], weight.shape[0])
    layer.load_state_dict({"weight": weight, "bias": bias})
    return layer.requires_grad_(False)


def with_risk(policy: torch.nn.Module, risk: Risk | None) -> torch.nn.Module:
    """Return one network of both, or the policy alone without a risk."""
    return policy if risk is None else PolicyWithRisk(policy, risk).eval()


def output_names(module: torch.nn.Module) -> tuple[str, ...]:
    """Return the names of a network's outputs in an exported file, in their order."""
    if isinstance(module, PolicyWithRisk):
        return ("q_values", "risk", "risk_recurrence")
    return ("q_values",)


def policy_metadata(config: TrainConfig, risk: RiskSign | None = None) -> dict[str, str]:
    """Return the metadata of a policy without its checksum; values other than text are JSON.

    ``config``: configuration of the training, with the robot that the export is for. ``risk``: when
    the policy's risk is a warning, if it has one.
    """
    layout, robot = config.perception, config.robot
    values: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "observation": describe_observation(layout),
        "bins": layout.bins,
        "bin_width": layout.bin_width,
        "frames": config.network.frames,
        "joints": JOINTS,
        "actions": turns(robot.angle_step).tolist(),
        "targets": {"meaning": MEANING, "window": robot.angle_step, "limit": robot.angle_limit},
        "decision_period": robot.decision_period,
        "robot": robot.model_dump(mode="json", exclude_none=True),
        "terrain": config.terrain.plugin_name,
        "terrain_config": resolver.to_dict(config.terrain),
        "seed": config.seed,
        "network": config.network.plugin_name,
    }
    if files := [p for p in plugin_references(config) if p.file is not None]:
        values["plugins"] = [{"kind": p.kind, "name": p.name, "file": p.file} for p in files]
    if risk is not None:
        values["risk"] = {
            "meaning": MEANING_OF_RISK,
            "horizon": risk.horizon,
            "threshold": risk.threshold,
            "lags": LAGS,
            "scale": SCALE,
        }
        if (escape := config.agent.escape) is not None:
            values["escape"] = {"meaning": MEANING_OF_ESCAPE, **asdict(escape)}
    if isinstance(layout, LidarSensor):
        values["map"] = {"meaning": MEANING_OF_MAP, **asdict(layout.map_quality)}
    return {
        f"{PREFIX}{name}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


def describe_observation(layout: ObservationLayout) -> list[dict[str, str]]:
    """Return the name, unit, frame and meaning of each of an observation's N + 3 numbers."""
    edges = pairwise(observation.edges(layout.bins, layout.bin_width))
    heights = [
        {
            "name": f"h_{i + 1}",
            "unit": "m",
            "frame": "L",
            "meaning": f"mean terrain height, up positive, for x in [{low:.3f}, {high:.3f}) m",
        }
        for i, (low, high) in enumerate(edges)
    ]
    angles = (
        ("R", "front flippers, above chassis positive"),
        ("R", "rear flippers, above chassis positive"),
        ("L", "pitch, nose up positive"),
    )
    return heights + [
        {"name": name, "unit": "rad", "frame": frame, "meaning": meaning}
        for name, (frame, meaning) in zip(observation.ANGLES, angles, strict=True)
    ]


Outputs = Callable[[NDArray[np.float32]], tuple[NDArray[np.float32], ...]]
"""Maps inputs of the network (M, F · (N + 3)) to Q-values (M, 9), and if it has a risk, to what the
network of the risk returns."""
OPSET = 18


def export_onnx(
    module: torch.nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, Outputs]:
    """Return the bytes of the model, and a function that computes its outputs."""
    onnx, runtime = (_import_package(name) for name in ("onnx", "onnxruntime"))
    _import_package("onnxscript")
    example = torch.zeros(2, input_size(config.network, config.perception))
    with _silent_exporter():
        program = torch.onnx.export(
            module,
            (example,),
            input_names=["observation"],
            output_names=list(output_names(module)),
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ExportError("torch returned no ONNX program")
    model = program.model_proto
    for node in model.graph.node:  # the exporter's notes contain stack traces with local paths
        del node.metadata_props[:]
    onnx.helper.set_model_props(model, metadata)
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString()
    session = runtime.InferenceSession(data, providers=["CPUExecutionProvider"])

    def outputs(observations: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
        return tuple(session.run(list(output_names(module)), {"observation": observations}))

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
        raise MissingExtraError(
            f"export onnx needs the package {name}, which is missing if flipperctl was installed "
            f"without its dependencies; pip install {name}"
        ) from error
