"""The checksum of an exported policy: it finds every change."""

from pathlib import Path

import pytest

from flipperctl.errors import PolicyError
from flipperctl.runtime import session as checksum
from tests.runtime.linear import write


@pytest.fixture
def whole(tmp_path: Path) -> bytes:
    return write(tmp_path / "p.onnx").read_bytes()


def test_every_flipped_bit_is_found_before_anything_is_parsed(whole: bytes) -> None:
    checksum.verify(whole, "p.onnx")
    for at in range(len(whole)):
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[at] ^= 1 << bit
            with pytest.raises(PolicyError, match=r"p\.onnx is damaged"):
                checksum.verify(bytes(damaged), "p.onnx")


def test_a_truncated_or_longer_file_is_damaged(whole: bytes) -> None:
    for data in (whole[:-1], whole[: len(whole) // 2], whole + b"\0", whole + whole):
        with pytest.raises(PolicyError, match="is damaged"):
            checksum.verify(data, "p.onnx")


def test_a_file_without_its_checksum_is_damaged(whole: bytes, tmp_path: Path) -> None:
    without = write(tmp_path / "q.onnx", checksum=False).read_bytes()
    for data in (without, whole.replace(b"flipperctl.sha256", b"flipperctl.sha257")):
        with pytest.raises(PolicyError, match="damaged: its SHA-256 cannot be found"):
            checksum.verify(data, "p.onnx")


def test_a_model_needs_exactly_one_placeholder() -> None:
    with pytest.raises(ValueError, match=r"must hold flipperctl\.sha256 once"):
        checksum.add_checksum(b"no metadata")
