"""Opens an exported policy with onnxruntime and checks it, by its SHA-256 first.

In: the bytes of a file. Out: a session, its metadata and the shapes of its input and output; or an
error before any other code parses them. The checksum is computed over the whole file with its own
64 hexadecimal digits set to 0, so that it covers every bit of graph and metadata.
"""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl.core.reading import read_whole
from flipperctl.core.risk import LAGS
from flipperctl.core.targets import ACTIONS
from flipperctl.errors import MissingExtraError, OldVersionError, PolicyError

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

FORMAT_VERSION = 2
"""Format of the metadata under ``flipperctl.*``; version 0.1 had 1, without a checksum."""
PREFIX = "flipperctl."
EXPORT_AGAIN = "train its policy again, and export it with this version"
CHECKSUM = f"{PREFIX}sha256"
PLACEHOLDER = "0" * 64
"""Value of the checksum entry while the checksum is computed."""
_FORMAT = f"{PREFIX}format_version"


def add_checksum(data: bytes) -> bytes:
    """Return a model's bytes with their checksum in place of ``PLACEHOLDER``.

    Raises:
        ValueError: the entry ``CHECKSUM`` does not hold the placeholder exactly once.
    """
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is None or data[start : start + len(PLACEHOLDER)] != PLACEHOLDER.encode():
        raise ValueError(f"the model's metadata must hold {CHECKSUM} once, as the placeholder")
    return _replace_at(data, start, hashlib.sha256(data).hexdigest())


def verify(data: bytes, where: str) -> None:
    """Check the bytes of a file against its checksum.

    Raises:
        PolicyError: the bytes were changed since the export, or ``flipperctl export onnx`` of this
            version did not write them.
    """
    start = _find_entry(data, CHECKSUM, len(PLACEHOLDER))
    if start is not None:
        found = data[start : start + len(PLACEHOLDER)]
        expected = hashlib.sha256(_replace_at(data, start, PLACEHOLDER)).hexdigest()
        if found != expected.encode():
            raise PolicyError(
                f"{where} is damaged, or was changed since its export: "
                "its SHA-256 does not match its contents"
            )
        return
    version = _find_entry(data, _FORMAT, 1)
    if version is None:
        raise PolicyError(
            f"{where} is damaged, or not a file of flipperctl export onnx: it holds no {_FORMAT}"
        )
    found_version = data[version : version + 1]
    if found_version == b"1":
        raise PolicyError(f"{where} {OldVersionError('0.1', EXPORT_AGAIN)}")
    if found_version == b"%d" % FORMAT_VERSION:
        raise PolicyError(f"{where} is damaged: its SHA-256 cannot be found")
    raise PolicyError(
        f"{where} has format version {found_version.decode(errors='replace')!r}, or is damaged; "
        f"this version of flipperctl reads {FORMAT_VERSION}"
    )


def _find_entry(data: bytes, key: str, length: int) -> int | None:
    """Return the offset of a metadata entry's value; None unless one of that length exists.

    An entry is a protobuf message of two strings: tag 1, length, key, tag 2, length, value. An
    entry that occurs twice counts as missing.
    """
    marker = b"\x0a%c%b\x12%c" % (len(key), key.encode(), length)
    at = data.find(marker)
    start = at + len(marker)
    if at < 0 or data.find(marker, start) >= 0 or start + length > len(data):
        return None
    return start


def _replace_at(data: bytes, start: int, value: str) -> bytes:
    return data[:start] + value.encode() + data[start + len(value) :]


Shapes = dict[str, tuple[str, list[int | str | None]]]
"""Type and shape of each input and output by name."""
INPUT, OUTPUT, RISK, RECURRENCE = "observation", "q_values", "risk", "risk_recurrence"
_RISKS = f", {RISK} tensor(float) [batch, 1] and {RECURRENCE} tensor(float) [batch, {len(LAGS)}]"
_LOGGER = logging.getLogger(__name__)


def open_session(path: Path) -> InferenceSession:
    """Open a session with one thread; a network of this size is slower with two.

    The checksum is verified before anything is parsed.

    Raises:
        MissingExtraError: onnxruntime is not installed.
        PolicyError: the file is missing, damaged, or not one that flipperctl exported.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise MissingExtraError(
            "an exported policy needs the package onnxruntime; install flipperctl[robot]"
        ) from error
    data = _read(path)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = 4  # errors are raised instead
    try:
        return onnxruntime.InferenceSession(
            data,
            options,
            providers=["CPUExecutionProvider"],
            enable_fallback=0,  # the fallback would only retry, and print to stdout
        )
    except Exception as error:  # onnxruntime's errors share no base class
        raise PolicyError(
            f"{path} is damaged or not an ONNX model that onnxruntime can run: {_reason(error)}"
        ) from error


def _read(path: Path) -> bytes:
    """Return the bytes of a file whose checksum is right."""

    def verified(data: bytes) -> bytes:
        verify(data, str(path))
        return data

    try:
        return read_whole(path, verified, PolicyError)
    except FileNotFoundError as error:
        raise PolicyError(f"{path}: there is no such policy file") from error
    except (OSError, ValueError) as error:  # ValueError: the name is not valid
        reason = getattr(error, "strerror", None) or error
        raise PolicyError(f"{path} cannot be read: {reason}") from error


def read_model(session: InferenceSession, where: str) -> tuple[dict[str, str], Shapes]:
    """Return the metadata, and the type and shape of each input and output by name.

    Raises:
        PolicyError: they are not text.
    """
    try:
        tensors = (*session.get_inputs(), *session.get_outputs())
        shapes = {tensor.name: (tensor.type, tensor.shape) for tensor in tensors}
        return session.get_modelmeta().custom_metadata_map, shapes
    except (UnicodeDecodeError, RuntimeError) as error:
        raise PolicyError(f"{where} is damaged: its names or metadata are not text") from error


def run_error(path: Path, error: Exception) -> PolicyError:
    """Return the error for a model that onnxruntime cannot run."""
    return PolicyError(f"{path}: onnxruntime cannot run the model: {_reason(error)}")


def _reason(error: Exception) -> str:
    words = " ".join(str(error).split()).rpartition(" : ")[2]
    return "".join(sign if sign.isprintable() else "?" for sign in words[:300])


def check_shapes(found: Shapes, size: int, where: str, *, risk: bool = False) -> None:
    """Check that the model maps inputs of ``size`` numbers to the Q-values of the actions.

    ``risk``: whether it has a risk too, as its metadata say.

    Raises:
        PolicyError: it does not.
    """
    expected = {
        INPUT: size,
        OUTPUT: len(ACTIONS),
        **({RISK: 1, RECURRENCE: len(LAGS)} if risk else {}),
    }
    fits = found.keys() == expected.keys() and all(
        kind == "tensor(float)" and len(shape) == 2 and shape[1] == expected[name]
        for name, (kind, shape) in found.items()
    )
    if not fits:
        shown = ", ".join(f"{name} {kind} {shape}" for name, (kind, shape) in found.items())
        raise PolicyError(
            f"{where}: the model has {shown}; {INPUT} tensor(float) [batch, {size}] and "
            f"{OUTPUT} tensor(float) [batch, {len(ACTIONS)}]"
            f"{_RISKS if risk else ''} is allowed"
        )
