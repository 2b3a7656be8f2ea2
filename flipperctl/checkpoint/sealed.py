"""Sealed files: a JSON document and tensors in a safetensors file, with a SHA-256 of both.

Reading detects every flipped bit and executes no code; keys of the document are unique and its
numbers finite. Equal contents give equal files, byte for byte. Checkpoints and recorded episodes
are such files.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flipperctl.core.reading import read_whole
from flipperctl.errors import CheckpointError

if TYPE_CHECKING:
    import torch


def decode(text: str) -> dict[str, Any]:
    """Return the mapping of a JSON text whose keys are unique and whose numbers are finite."""
    try:
        raw = json.loads(
            text,
            object_pairs_hook=_unique_keys,
            parse_constant=_refuse_constant,
            parse_float=_finite,
        )
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(raw, dict):
        raise ValueError(f"it must be a mapping; it is a {type(raw).__name__}")
    return raw


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        duplicate = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it holds the key {duplicate!r:.40} twice")
    return found


def _refuse_constant(constant: str) -> float:
    raise ValueError(f"it holds {constant}; finite numbers are allowed")


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse_constant(number[:40])


def require_equal_layout(
    found: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]
) -> None:
    """Check that tensors have the expected names, shapes and types and hold finite numbers.

    A number may be infinite where the expected one is infinite, as in a mask.
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


def serialize(text: str, tensors: Mapping[str, torch.Tensor]) -> bytes:
    """Return the bytes of a sealed file with its checksum; equal arguments give equal bytes.

    ``text``: the JSON text of the document.
    """
    from safetensors.torch import save

    held = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    data = save(held, {"flipperctl": text, "sha256": digest(text, held)})
    # safetensors writes its metadata in an order that differs between processes.
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    ordered = {"__metadata__": dict(sorted(header.pop("__metadata__").items())), **header}
    text = json.dumps(ordered, separators=(",", ":"))
    text += " " * (-len(text) % 8)  # tensors lie at multiples of 8 bytes
    return len(text).to_bytes(8, "little") + text.encode() + data[8 + length :]


def read(path: Path, noun: str) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the text of the document and the tensors of a sealed file.

    ``noun``: kind of file for the errors, such as "checkpoint".
    """
    import safetensors.torch  # noqa: F401  # takes a second, before the file is opened

    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such {noun}")
    try:
        return read_whole(path, lambda data: _parse(data, path, noun), CheckpointError)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such {noun}") from error
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error


def _parse(data: bytes, path: Path, noun: str) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the text and the tensors of the bytes of the file at ``path``."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    start = data[:9]
    # A safetensors file begins with the length of its header, 8 bytes of any value, and "{"; a
    # pickle with 0x80 and the number of its protocol, 2 to 5.
    pickled = start[:1] == b"\x80" and start[1:2] in (b"\2", b"\3", b"\4", b"\5")
    if start[8:] != b"{" and (pickled or start[:4] == b"PK\x03\x04"):
        raise CheckpointError(
            f"{path} is a pickle or a zip archive, not a safetensors file; "
            "flipperctl never loads these, since they can run code"
        )
    try:
        tensors = load(data)
        length = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__", {})
    except (SafetensorError, ValueError) as error:
        raise CheckpointError(f"{path} is damaged or not a safetensors file: {error}") from error
    if "flipperctl" not in metadata:
        raise CheckpointError(f"{path} is a safetensors file, but not a {noun} of flipperctl")
    text = metadata["flipperctl"]
    if metadata.get("sha256") != digest(text, tensors):
        raise CheckpointError(f"{path} is damaged: its SHA-256 does not match its contents")
    return text, tensors


def digest(text: str, tensors: Mapping[str, torch.Tensor]) -> str:
    """Return the SHA-256 of a text and of the names, types, shapes and values of tensors."""
    import torch

    found = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        found.update(f"{name}:{tensor.dtype}:{tuple(tensor.shape)}".encode())
        if tensor.numel():  # torch refuses to view an empty tensor as bytes
            found.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return found.hexdigest()
