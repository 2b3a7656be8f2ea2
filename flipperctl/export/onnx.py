"""Export of a network as an ONNX model, with its metadata in the model."""

from __future__ import annotations

import importlib
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.config import TrainConfig
from flipperctl.errors import ExportError, FlipperctlError, MissingExtraError
from flipperctl.export.folded import folded
from flipperctl.export.parity import Outputs, compare
from flipperctl.export.risky import output_names

OPSET = 18


def export_onnx(
    module: torch.nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, Outputs]:
    """Return the bytes of the model, and a function that computes its outputs.

    Raises:
        MissingExtraError: a package that ONNX needs is not installed.
        ExportError: torch returned no model.
    """
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


def compare_onnx(
    module: torch.nn.Module, config: TrainConfig, observations: NDArray[np.float32]
) -> dict[str, Any]:
    """Export a network as ONNX without writing a file, and compare it with torch.

    Returns the result of ``compare``.

    Raises:
        MissingExtraError: a package that ONNX needs is not installed.
        ExportError: torch cannot export the network, or the exported one disagrees with torch.
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
