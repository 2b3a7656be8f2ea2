"""Export of a policy: build the file, compare it with torch, and only then write it.

In: a checkpoint. Out: an ONNX or pt2 file, and the result of the comparison.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from flipperctl.checkpoint import Checkpoint
from flipperctl.errors import ExportError
from flipperctl.export.folded import folded
from flipperctl.export.metadata import policy_metadata
from flipperctl.export.onnx import export_onnx
from flipperctl.export.parity import compare, rollout_observations
from flipperctl.export.pt2 import export_pt2
from flipperctl.files import write_bytes
from flipperctl.guard import fault
from flipperctl.policies.trained import policy_module
from flipperctl.runtime.checksum import CHECKSUM, PLACEHOLDER, add_checksum

Format = Literal["onnx", "pt2"]
OBSERVATIONS = 1000
"""Least number of observations that are compared."""


def export(checkpoint: Checkpoint, format: Format, output: Path) -> dict[str, Any]:
    """Write the policy to ``output`` and return what the comparison found.

    Raises:
        MissingExtraError: the format is ONNX and a package that it needs is not installed.
        ExportError: the exported policy disagrees with torch; nothing is written.
        OutputError: the file cannot be written.
    """
    config = checkpoint.config()
    module = policy_module(checkpoint)
    observations = rollout_observations(config, module, OBSERVATIONS)
    metadata = policy_metadata(checkpoint)
    try:
        if format == "onnx":
            metadata = {**metadata, CHECKSUM: PLACEHOLDER}
            data, q_values = export_onnx(folded(module), config, metadata)
            data = add_checksum(data)
        else:
            data, q_values = export_pt2(folded(module), config, metadata)
    except BaseException as error:  # the exporters run the network's code, and wrap its errors
        raise fault(error, config.network, "forward", ExportError, while_=" (export)") from error
    found = compare(module, q_values, observations)
    write_bytes(output, data)
    return {"format": format, "output": str(output), "bytes": len(data), **found}
