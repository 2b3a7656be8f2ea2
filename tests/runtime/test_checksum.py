"""The checksum of an exported policy: it finds every change, and old files can still be read."""

import logging
from pathlib import Path

import pytest

from flipperctl.errors import PolicyError
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime import session as checksum
from tests.runtime.linear import FORMAT_1, write


@pytest.fixture
def whole(tmp_path: Path) -> bytes:
    return write(tmp_path / "p.onnx").read_bytes()


def test_every_flipped_bit_is_found_before_anything_is_parsed(whole: bytes) -> None:
    assert checksum.verify(whole, "p.onnx")
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


def test_a_new_file_without_its_checksum_is_not_read_as_an_old_one(
    whole: bytes, tmp_path: Path
) -> None:
    without = write(tmp_path / "q.onnx", checksum=False).read_bytes()
    disguised = without.replace(b"format_version\x12\x012", b"format_version\x12\x011")
    assert disguised != without
    for data in (without, disguised, whole.replace(b"flipperctl.sha256", b"flipperctl.sha257")):
        with pytest.raises(PolicyError, match="damaged: its SHA-256 cannot be found"):
            checksum.verify(data, "p.onnx")


def test_a_file_of_format_1_is_read_with_one_line_of_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "old.onnx", **FORMAT_1)
    with caplog.at_level(logging.WARNING):
        policies = [OnnxPolicy(path) for _ in range(3)]
    assert dict(policies[0].interface.terrain_config) == {"name": "stair"}
    (warning,) = caplog.messages
    assert str(path) in warning
    assert "cannot be checked" in warning
    assert "\n" not in warning
    assert capfd.readouterr().out == ""


def test_a_damaged_file_of_format_1_raises_the_runtime_s_own_error_and_prints_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = write(tmp_path / "old.onnx", **FORMAT_1).read_bytes()
    path = tmp_path / "damaged.onnx"
    refused = 0
    for at in range(0, len(whole), 37):
        damaged = bytearray(whole)
        damaged[at] ^= 0x80
        path.write_bytes(damaged)
        try:
            OnnxPolicy(path)
        except PolicyError:
            refused += 1
    assert refused > 20
    assert capfd.readouterr().out == ""


def test_a_model_needs_exactly_one_placeholder() -> None:
    with pytest.raises(ValueError, match=r"must hold flipperctl\.sha256 once"):
        checksum.add_checksum(b"no metadata")
