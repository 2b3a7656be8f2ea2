"""The lock of a run directory: one process holds it, and a dead process releases it."""

import errno
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from flipperctl.errors import OutputError, RunHeldError
from flipperctl.results import hold, is_held

DIES = """
import errno, filelock._unix, os, sys
from pathlib import Path
def none(*a): raise OSError(errno.ENOLCK, "no locks available")
if {soft}: filelock._unix.fcntl.flock = none
from flipperctl.results import hold
context = hold(Path(sys.argv[1]))
context.__enter__()
os._exit(9)
"""


def dies_holding(folder: Path, *, soft: bool) -> None:
    """Run a process that ends without releasing the lock."""
    command = [sys.executable, "-c", DIES.format(soft=soft), str(folder)]
    assert subprocess.run(command, check=False, timeout=60).returncode == 9


def without_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    monkeypatch.setattr("filelock._unix.fcntl.flock", none)


@pytest.mark.parametrize("soft", [False, True])
def test_the_error_for_a_second_process_names_the_holder(
    soft: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if soft:
        without_locks(monkeypatch)
    with hold(tmp_path):
        note = json.loads((tmp_path / ".run.lock.json").read_text())
        before = {path: path.read_bytes() for path in tmp_path.iterdir()}
        with pytest.raises(RunHeldError) as refused, hold(tmp_path):
            pass
        assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    text = str(refused.value)
    assert f"process {os.getpid()} on {socket.gethostname()} since {note['since']}" in text
    assert (".run.softlock" in text) == soft
    assert len(text.splitlines()) == 1
    with hold(tmp_path):
        assert (tmp_path / ".run.lock.json").exists()
    assert not (tmp_path / ".run.lock.json").exists()


@pytest.mark.parametrize("soft", [False, True])
def test_a_process_that_died_holds_no_lock(
    soft: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dies_holding(tmp_path, soft=soft)
    assert (tmp_path / ".run.lock.json").exists()
    if soft:
        without_locks(monkeypatch)
    with hold(tmp_path):
        assert json.loads((tmp_path / ".run.lock.json").read_text())["pid"] == os.getpid()


def test_a_run_is_held_while_its_process_lives(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    with hold(tmp_path):
        assert is_held(tmp_path)
        assert not is_held(tmp_path, "sweep")
    assert not is_held(tmp_path)
    dies_holding(tmp_path, soft=False)
    assert not is_held(tmp_path)
    note = tmp_path / ".run.lock.json"
    note.write_text(json.dumps({"pid": 1, "host": "elsewhere", "since": "yesterday"}))
    assert not is_held(tmp_path)  # whoever wrote it, the lock is free


def test_locks_of_other_names_and_folders_are_independent(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with hold(tmp_path), hold(tmp_path, "sweep"), hold(tmp_path / "run"):
        pass


def test_a_folder_that_cannot_be_written_cannot_be_held(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"), hold(tmp_path / "file"):
        pass
