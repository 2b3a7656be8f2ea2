"""Export of a policy as ONNX or as a torch.export archive, checked before it gets its name.

In: a checkpoint. Out: a file whose Q-values agree with torch on real rollouts, and what the
comparison found.
"""

from __future__ import annotations

import importlib
import io
import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl import __version__
from flipperctl.agent.frames import input_size, stacked
from flipperctl.api import ACTIONS, ObservationLayout, Perception
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ExportError, FlipperctlError, MissingExtraError
from flipperctl.files import write_bytes
from flipperctl.guard import fault
from flipperctl.policies.trained import TrainedPolicy, policy_module
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import episode_seed
from flipperctl.runtime.checksum import CHECKSUM, FORMAT_VERSION, PLACEHOLDER, PREFIX, sealed

Format = Literal["onnx", "pt2"]
OPSET = 18
TOLERANCE = 1e-4
"""Largest difference of a Q-value that counts as rounding, relative to the largest |Q|."""
OBSERVATIONS = 1000

Run = Callable[[NDArray[np.float32]], NDArray[np.float32]]


def export(checkpoint: Checkpoint, format: Format, output: Path) -> dict[str, Any]:
    """Write the policy to ``output`` and return what the check found.

    Raises:
        MissingExtraError: ONNX is asked for and a package that it needs is not installed.
        ExportError: the exported policy disagrees with torch; nothing is written.
        OutputError: the file cannot be written.
    """
    config = checkpoint.config()
    module = policy_module(checkpoint)
    observations = rollout_observations(config, module, OBSERVATIONS)
    details = properties(checkpoint)
    try:
        if format == "onnx":
            data, run = _onnx(module, config, {**details, CHECKSUM: PLACEHOLDER})
            data = sealed(data)
        else:
            data, run = _pt2(module, config, details)
    except BaseException as error:  # the exporters run the network's code, and wrap what it raises
        raise fault(error, config.network, "forward", ExportError, while_=" (export)") from error
    found = compare(module, run, observations)
    write_bytes(output, data)
    return {"format": format, "output": str(output), "bytes": len(data), **found}


def properties(checkpoint: Checkpoint) -> dict[str, str]:
    """What a robot must know to use the policy: strings under ``flipperctl.*``."""
    config = checkpoint.config()
    layout, robot = config.perception, config.robot
    table = [[front * robot.angle_step, rear * robot.angle_step] for front, rear in ACTIONS]
    geometry = robot.model_dump(mode="json")
    values: dict[str, Any] = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "observation": observation_layout(layout),
        "bins": layout.bins,
        "bin_width": layout.bin_width,
        "frames": config.network.frames,
        "actions": table,
        "decision_period": robot.decision_period,
        "robot": geometry,
        "terrain": config.terrain.plugin_name,
        "terrain_config": resolver.container(config.terrain),
        "seed": config.seed,
        "network": config.network.plugin_name,
    }
    return {
        f"{PREFIX}{name}": value if isinstance(value, str) else json.dumps(value)
        for name, value in values.items()
    }


def observation_layout(layout: ObservationLayout) -> list[dict[str, str]]:
    """Name, unit, frame and meaning of each number of an observation."""
    low, width = -layout.reach, layout.bin_width
    heights = [
        {
            "name": f"h_{i + 1}",
            "unit": "m",
            "frame": "L",
            "meaning": "mean terrain height, up positive, for x in "
            f"[{low + i * width:.3f}, {low + (i + 1) * width:.3f}) m",
        }
        for i in range(layout.bins)
    ]
    flipper = {"unit": "rad", "frame": "R"}
    return [
        *heights,
        {"name": "theta_f1", **flipper, "meaning": "front flippers, above chassis positive"},
        {"name": "theta_f2", **flipper, "meaning": "rear flippers, above chassis positive"},
        {"name": "theta_R", "unit": "rad", "frame": "L", "meaning": "pitch, nose up positive"},
    ]


class _Recorder(TrainedPolicy):
    """Acts like the policy and notes what its network sees."""

    def __init__(self, module: torch.nn.Module, frames: int) -> None:
        super().__init__(module, frames)
        self.seen: list[NDArray[np.float32]] = []

    def act(self, p: Perception) -> int:
        self.seen.append(stacked(p.recent, self.frames))
        return super().act(p)


def rollout_observations(
    config: TrainConfig, module: torch.nn.Module, count: int
) -> NDArray[np.float32]:
    """What the network sees in its own episodes, ``count`` times or more: (M, F · (N + 3))."""
    env = FlipperEnv(config=config.environment())
    recorder = _Recorder(module, config.network.frames)
    episode = 0
    while len(recorder.seen) < count:
        play(env, recorder, episode_seed("evaluation", config.seed, episode))
        episode += 1
    return np.stack(recorder.seen)


def compare(module: torch.nn.Module, run: Run, observations: NDArray[np.float32]) -> dict[str, Any]:
    """Largest difference of Q and agreement of the chosen action, over real observations.

    Raises:
        ExportError: the difference is more than rounding, or an action differs that no
            rounding explains.
    """
    with torch.inference_mode():
        expected = module(torch.from_numpy(observations)).numpy()  # (M, 9)
    actual = run(observations)
    if actual.shape != expected.shape:
        raise ExportError(f"the exported policy gives {actual.shape}, torch {expected.shape}")
    difference = float(np.abs(expected - actual).max())
    limit = TOLERANCE * max(1.0, float(np.abs(expected).max()))
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
        "action_agreement": agreement,
    }


def compare_onnx(
    module: torch.nn.Module, config: TrainConfig, observations: NDArray[np.float32]
) -> dict[str, Any]:
    """Like ``compare``, with the network as ONNX; no file is written.

    Raises:
        MissingExtraError: a package that ONNX needs is not installed.
        ExportError: torch cannot export the network, or the exported one disagrees.
    """
    try:
        _, run = _onnx(module, config, {})
    except FlipperctlError:
        raise
    except Exception as error:
        raise ExportError(f"torch cannot export it as ONNX: {_first_line(error)}") from error
    return compare(module, run, observations)


def _first_line(error: Exception) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), repr(error))


def _onnx(
    module: torch.nn.Module, config: TrainConfig, details: dict[str, str]
) -> tuple[bytes, Run]:
    onnx, runtime = (_package(name) for name in ("onnx", "onnxruntime"))
    _package("onnxscript")
    example = torch.zeros(2, input_size(config.network, config.perception))
    with _quiet():
        program = torch.onnx.export(
            module,
            (example,),
            input_names=["observation"],
            output_names=["q_values"],
            dynamic_shapes=({0: torch.export.Dim("batch")},),
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise ExportError("torch gave no ONNX program")
    model = program.model_proto
    for node in model.graph.node:  # the exporter's notes: stack traces with local paths
        del node.metadata_props[:]
    onnx.helper.set_model_props(model, details)
    onnx.checker.check_model(model, full_check=True)
    data: bytes = model.SerializeToString()
    session = runtime.InferenceSession(data, providers=["CPUExecutionProvider"])

    def run(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        result: NDArray[np.float32] = session.run(["q_values"], {"observation": observations})[0]
        return result

    return data, run


def _pt2(
    module: torch.nn.Module, config: TrainConfig, details: dict[str, str]
) -> tuple[bytes, Run]:
    example = torch.zeros(2, input_size(config.network, config.perception))
    program = torch.export.export(
        module, (example,), dynamic_shapes=({0: torch.export.Dim("batch")},)
    )
    buffer = io.BytesIO()
    torch.export.save(program, buffer, extra_files=dict(details))
    buffer.seek(0)
    # The bytes just made in this process, read back to check what the file will hold.
    exported = torch.export.load(buffer).module()

    def run(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.inference_mode():
            result: NDArray[np.float32] = exported(torch.from_numpy(observations)).numpy()
        return result

    return buffer.getvalue(), run


@contextmanager
def _quiet() -> Iterator[None]:
    """The exporter without its notes on optional packages and its own deprecations."""
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


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"export onnx needs the package {name}, which comes with flipperctl unless that was "
            f"installed without its dependencies; pip install {name}"
        ) from error
