"""Export of a network as a ``torch.export`` archive."""

from __future__ import annotations

import io

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.config import TrainConfig
from flipperctl.export.parity import Outputs


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
