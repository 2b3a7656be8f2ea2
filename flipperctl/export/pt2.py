"""Export of a network as a ``torch.export`` archive."""

from __future__ import annotations

import io

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.frames import input_size
from flipperctl.config import TrainConfig
from flipperctl.export.parity import QFunction


def export_pt2(
    module: torch.nn.Module, config: TrainConfig, metadata: dict[str, str]
) -> tuple[bytes, QFunction]:
    """Return the bytes of the archive, and a function that computes its Q-values."""
    example = torch.zeros(2, input_size(config.network, config.perception))
    program = torch.export.export(
        module, (example,), dynamic_shapes=({0: torch.export.Dim("batch")},)
    )
    buffer = io.BytesIO()
    torch.export.save(program, buffer, extra_files=dict(metadata))
    buffer.seek(0)
    # Read back what the file will hold; the bytes come from this process, so loading is safe.
    exported = torch.export.load(buffer).module()

    def q_values(observations: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.inference_mode():
            result: NDArray[np.float32] = exported(torch.from_numpy(observations)).numpy()
        return result

    return buffer.getvalue(), q_values
