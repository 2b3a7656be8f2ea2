"""A check of tensors against expected ones: names, shapes, types and finite numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch


def require_equal_layout(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]
) -> None:
    """Check that tensors have the expected names, shapes and types and hold finite numbers.

    A number may be infinite where the expected one is infinite, as in a mask.

    Raises:
        ValueError: a tensor differs; the message names the first one.
    """
    if missing := sorted(expected.keys() - found.keys()):
        raise ValueError(f"{missing[0]} is missing")
    if unknown := sorted(found.keys() - expected.keys()):
        raise ValueError(f"there is no tensor {unknown[0]!r:.60}")
    for name, wanted in expected.items():  # safetensors lists a file's tensors in any order
        tensor = found[name]
        if tensor.shape != wanted.shape or tensor.dtype != wanted.dtype:
            raise ValueError(
                f"{name} is {_shape_and_type(tensor)}; {_shape_and_type(wanted)} is needed"
            )
        if not bool((tensor.isfinite() | ~wanted.cpu().isfinite()).all()):
            raise ValueError(f"{name} holds numbers that are not finite")


def _shape_and_type(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"
