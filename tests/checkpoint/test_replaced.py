"""A file that another process replaces: one of the two policies, or a word to try again."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from flipperctl.checkpoint import document as sealed
from flipperctl.core import reading
from flipperctl.errors import CheckpointError, PolicyError
from flipperctl.runtime.interface import open_session


def written(path: Path, size: int) -> Path:
    path.write_bytes(sealed.serialize("{}", {"weight": torch.arange(size)}))
    return path


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[Callable[[], object]]:
    """Actions that happen between the opening of a file and the next ones, one each."""
    todo: list[Callable[[], object]] = []
    read = Path.read_bytes

    def bytes_then(path: Path) -> bytes:
        data = read(path)
        if todo:
            todo.pop(0)()
        return data

    monkeypatch.setattr(Path, "read_bytes", bytes_then)
    monkeypatch.setattr(reading, "_PAUSE", 0.0)
    return todo


def test_a_file_that_is_replaced_while_it_is_read_is_the_old_one(
    tmp_path: Path, steps: list[Callable[[], object]]
) -> None:
    path, other = written(tmp_path / "a", 3), written(tmp_path / "b", 50)
    steps.append(lambda: other.replace(path))
    assert len(sealed.read(path, "file")[1]["weight"]) == 3
    assert len(sealed.read(path, "file")[1]["weight"]) == 50


def test_a_file_that_is_being_copied_is_read_again(
    tmp_path: Path, steps: list[Callable[[], object]]
) -> None:
    path, whole = tmp_path / "a", written(tmp_path / "b", 50)
    path.write_bytes(whole.read_bytes()[:200])
    steps.append(lambda: shutil.copy(whole, path))
    assert len(sealed.read(path, "file")[1]["weight"]) == 50


def test_a_file_that_never_stays_as_it_is_is_not_called_damaged(
    tmp_path: Path, steps: list[Callable[[], object]]
) -> None:
    path = tmp_path / "a.onnx"
    path.write_bytes(b"{")
    for read, kind in (
        (lambda: sealed.read(path, "file"), CheckpointError),
        (lambda: open_session(path), PolicyError),
    ):
        steps.extend([lambda: path.write_bytes(b"x" * (len(steps) + 1))] * 2000)
        with pytest.raises(kind, match=r"a\.onnx is being replaced by another process; try again"):
            read()
        steps.clear()
