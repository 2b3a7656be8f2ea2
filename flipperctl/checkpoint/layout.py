"""Whether tensors are those that a network is made of: names, shapes, types, finite numbers."""

from __future__ import annotations

from collections.abc import Mapping

import torch


def require_equal_layout(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]
) -> None:
    """Names, shapes and types of the tensors are those expected, and all numbers are finite.

    A number may be infinite where the expected one is (a mask, say).

    Raises:
        ValueError: they are not; the text names the first that differs.
    """
    if lacking := sorted(expected.keys() - found.keys()):
        raise ValueError(f"{lacking[0]} is missing")
    if further := sorted(found.keys() - expected.keys()):
        raise ValueError(f"there is no tensor {further[0]!r:.60}")
    for name, tensor in found.items():
        wanted = expected[name]
        if tensor.shape != wanted.shape or tensor.dtype != wanted.dtype:
            raise ValueError(f"{name} is {_said(tensor)}; {_said(wanted)} is needed")
        if not bool((tensor.isfinite() | ~wanted.cpu().isfinite()).all()):
            raise ValueError(f"{name} holds numbers that are not finite")


def _said(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"
