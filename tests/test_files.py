"""Files are written whole, by any number of processes at once."""

import threading
from pathlib import Path

import pytest

from flipperctl.errors import OutputError
from flipperctl.files import check_writable, remove_partial, write_bytes


def test_writers_of_one_file_do_not_disturb_each_other(tmp_path: Path) -> None:
    """With one name for the partial file, one writer renames what another is writing."""
    target = tmp_path / "a.bin"
    errors: list[BaseException] = []

    def write(byte: int) -> None:
        try:
            for _ in range(40):
                write_bytes(target, bytes([byte]) * 20_000)
                found = target.read_bytes()
                assert len(found) == 20_000
                assert len(set(found)) == 1
        except BaseException as error:  # noqa: BLE001  # shown below, in the test's own thread
            errors.append(error)

    threads = [threading.Thread(target=write, args=(byte,)) for byte in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert [path.name for path in tmp_path.iterdir()] == ["a.bin"]


def test_partial_files_of_dead_processes_are_removed_and_no_others(tmp_path: Path) -> None:
    kept = [".b[1].bin.12-ab.part", "b[1].bin", ".b1.bin.12-ab.part"]
    for name in (*kept, ".a[1].bin.12-ab.part", ".a[1].bin.part"):
        (tmp_path / name).touch()
    remove_partial(tmp_path / "a[1].bin")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


def test_a_file_of_another_kind_is_kept(tmp_path: Path) -> None:
    """Such as the source of a plugin, typed for the name of the policy."""
    (tmp_path / "mine.py").write_text("source")
    with pytest.raises(OutputError, match=r"mine.py exists, and is kept since it is no .onnx file"):
        check_writable(tmp_path / "mine.py", ".onnx")
    check_writable(tmp_path / "yours.py", ".onnx")
    (tmp_path / "old.onnx").write_text("policy")
    check_writable(tmp_path / "old.onnx", ".onnx")


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="folder cannot be written"):
        write_bytes(tmp_path / "folder", b"1")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
