"""Files are written whole, by any number of processes at once."""

import json
import os
import re
import threading
from contextlib import nullcontext
from pathlib import Path

import pytest

from flipperctl.env.metrics import RENAMED
from flipperctl.errors import OutputError, RequestError, WriteError
from flipperctl.evaluation.stored import read_document
from flipperctl.text.files import (
    OutputKind,
    at_home,
    check_output,
    read_csv,
    remove_partial,
    write_bytes,
)


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
    for name in (*kept, ".a[1].bin.12-ab.part"):
        (tmp_path / name).touch()
    remove_partial(tmp_path / "a[1].bin")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(kept)


NOTES = OutputKind("a note", (".md", ".txt"), re.compile(rb"\Aours"))


@pytest.mark.parametrize(
    ("content", "kept"), [(b"ours, of yesterday", False), (b"", False), (b"not ours", True)]
)
def test_only_an_earlier_output_of_the_same_kind_is_replaced(
    content: bytes, kept: bool, tmp_path: Path
) -> None:
    """So neither an input nor a file of another program is, whatever its suffix."""
    there = tmp_path / "there.TXT"
    there.write_bytes(content)
    (tmp_path / "linked.md").symlink_to(there)
    check_output(tmp_path / "new.md", NOTES)
    for path in (there, tmp_path / "linked.md"):
        with pytest.raises(OutputError, match="kept") if kept else nullcontext():
            check_output(path, NOTES)


def test_an_output_has_a_suffix_of_its_kind_and_is_a_file(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"a note is a \.md or \.txt file; the suffix is '\.py'"):
        check_output(tmp_path / "mine.py", NOTES)
    os.mkfifo(tmp_path / "pipe.txt")
    with pytest.raises(OutputError, match="kept"):
        check_output(tmp_path / "pipe.txt", NOTES)


def test_a_file_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="folder cannot be written"):
        write_bytes(tmp_path / "folder", b"1")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_failing_write_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    write_bytes(tmp_path / "a", b"1")
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(WriteError, match=r"No space left on device.*the old file is kept"):
        write_bytes(tmp_path / "a", b"2")
    with pytest.raises(WriteError, match=r"No space left on device\)$"):
        write_bytes(tmp_path / "new", b"2")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"1")]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("~", "/home/ann"),
        ("~/runs", "/home/ann/runs"),
        ("--output=~/runs", "--output=/home/ann/runs"),
        ("terrain.path=[~/a,~/b.csv]", "terrain.path=[/home/ann/a,/home/ann/b.csv]"),
        ("terrain.path='~/a'", "terrain.path='/home/ann/a'"),
        ("~/a:~/b", "/home/ann/a:/home/ann/b"),
        ("~rewards.pitch", "~rewards.pitch"),
        ("--output=~root/runs", f"--output={Path('~root').expanduser()}/runs"),
        ("~nobody.here/runs", "~nobody.here/runs"),
        ("a~/b", "a~/b"),
        (Path("~/a"), Path("/home/ann/a")),
        ({"path": ["~/a", 3]}, {"path": ["/home/ann/a", 3]}),
    ],
)
def test_a_tilde_that_begins_a_path_is_the_home_folder(
    value: object, expected: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", "/home/ann")
    assert at_home(value) == expected


def test_a_link_to_a_file_is_written_through(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_bytes(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_bytes() == b"new"
    (tmp_path / "loop").symlink_to("loop")
    write_bytes(tmp_path / "loop", b"new")
    assert (tmp_path / "loop").read_bytes() == b"new"


def test_a_table_of_an_older_version_has_todays_names(tmp_path: Path) -> None:
    table = tmp_path / "episodes.csv"
    table.write_text("seed,pitch_variation\n1,0.5\n")
    (row,) = read_csv(table, ("pitch_variation_decisions",), RENAMED)
    assert row == {"seed": "1", "pitch_variation_decisions": "0.5"}
    with pytest.raises(RequestError, match="there is no column 'pitch_variation'"):
        read_csv(table, ("pitch_variation",), RENAMED)


def test_a_document_of_an_older_version_has_todays_names(tmp_path: Path) -> None:
    scene = {"terrain": "step", "pitch_variation": {"mean": 1.0}}
    (tmp_path / "summary.json").write_text(json.dumps({"scenes": [scene]}))
    (read,) = read_document(tmp_path)["scenes"]
    assert read == scene | {"pitch_variation_decisions": {"mean": 1.0}}
