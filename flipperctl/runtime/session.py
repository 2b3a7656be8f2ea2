"""Opens an exported policy with onnxruntime and checks it.

In: a file. Out: a session, its metadata and the shapes of its input and output.
"""

from __future__ import annotations

import functools
import logging
from pathlib import Path
from typing import TYPE_CHECKING

from flipperctl.core.actions import ACTIONS
from flipperctl.core.reading import read_whole
from flipperctl.core.risk import LAGS
from flipperctl.errors import MissingExtraError, PolicyError
from flipperctl.runtime.checksum import verify

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

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
        if not verify(data, str(path)):
            _warn_once(str(path))
        return data

    try:
        return read_whole(path, verified, PolicyError)
    except FileNotFoundError as error:
        raise PolicyError(f"{path}: there is no such policy file") from error
    except (OSError, ValueError) as error:  # ValueError: the name is not valid
        reason = getattr(error, "strerror", None) or error
        raise PolicyError(f"{path} cannot be read: {reason}") from error


@functools.cache
def _warn_once(path: str) -> None:
    _LOGGER.warning(
        "%s was exported by flipperctl 0.1 without a checksum: damage cannot be checked, and the "
        "file holds only the name of its terrain; export it again",
        path,
    )


@functools.cache
def warn_of_targets(path: str) -> None:
    """Warn once that a file does not state the rule for its targets."""
    _LOGGER.warning(
        "%s does not state how a blocked flipper is turned (flipperctl.targets): it was exported "
        "by an earlier flipperctl, whose targets were not bounded by measured angles; they are "
        "computed as in its training. Export it again to bound them",
        path,
    )


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
