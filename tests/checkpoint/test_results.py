"""Folders of results: one writer at a time, whole sets of files, nothing of the user's removed."""

import errno
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from flipperctl.checkpoint.results import ResultFolder, hold, is_held, result_folder
from flipperctl.errors import WriteError
from flipperctl.requests import evaluation
from flipperctl.text import files
from tests.cli.call import Done, call

SHORT = ["episode.run_up=0.8", "episode.run_out=0.2"]
PLAY = ["eval", "--controller", "level", *SHORT, "--episodes", "1", "--output", "out"]
TABLES = {"episodes.csv", "summary.json", "table.csv", "table.tex", "traces.npz", "report.html"}
CELLS = {"cells", "cells.csv"}
"""The episodes themselves, which no later evaluation removes."""


def shown(folder: Path) -> set[str]:
    """The names in a folder that are not hidden."""
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}


def refused(done: Done) -> str:
    """The line with which the command was refused."""
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    return done.err


def test_files_that_no_command_has_written_are_kept(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "flat.png").write_bytes(b"mine")
    assert call(*PLAY, "terrain=ramp", cwd=tmp_path).code == 0  # writes ramp.png
    text = refused(call(*PLAY, "terrain=flat", cwd=tmp_path))
    assert "out/flat.png is not of an earlier result and would be replaced" in text
    assert (out / "flat.png").read_bytes() == b"mine"


def test_a_folder_in_use_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with hold(tmp_path / "out", "results"):
        text = refused(call(*PLAY, "terrain=flat", cwd=tmp_path))
    assert "out is in use by another process; wait for it, or stop it" in text
    assert shown(tmp_path / "out") == set()


def test_a_second_evaluation_leaves_no_file_of_the_first_and_all_of_the_users(
    tmp_path: Path,
) -> None:
    assert call(*PLAY, "terrain=flat,step", cwd=tmp_path).code == 0
    out = tmp_path / "out"
    assert shown(out) == {*TABLES, *CELLS, "flat.png", "step.png"}
    (out / "mine.png").write_bytes(b"mine")
    with result_folder(out, "map", ["map.json"]) as folder:
        folder.replace(lambda part: (part / "map.json").touch())
    before = (out / "flat.png").stat().st_mtime_ns
    done = call(*PLAY, "terrain=flat", cwd=tmp_path)
    assert done.code == 0, done.err
    assert shown(out) == {*TABLES, *CELLS, "flat.png", "mine.png", "map.json"}
    assert (out / "flat.png").stat().st_mtime_ns > before
    assert "step" not in (out / "table.csv").read_text()


def test_a_run_is_no_folder_for_an_evaluation(tmp_path: Path) -> None:
    run = tmp_path / "out"
    run.mkdir()
    for name in ("config.yaml", "summary.json"):
        (run / name).write_text("a: 1\n")
    assert "out holds a training run, whose summary.json" in refused(
        call(*PLAY, "terrain=flat", cwd=tmp_path)
    )
    assert (run / "summary.json").read_text() == "a: 1\n"


def test_a_file_that_cannot_be_written_is_found_before_the_first_episode(tmp_path: Path) -> None:
    (tmp_path / "out" / "table.csv").mkdir(parents=True)
    assert "out/table.csv cannot be written" in refused(call(*PLAY, "terrain=flat", cwd=tmp_path))


def test_a_full_disk_leaves_the_earlier_files_as_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert call(*PLAY, "terrain=flat", cwd=tmp_path).code == 0
    before = {p: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.is_file()}

    def full(path: Path, data: bytes) -> None:
        raise WriteError(f"{path}: writing failed half way (No space left on device)")

    monkeypatch.setattr(evaluation, "write_bytes", full)  # table.tex, after the other files
    done = call(*PLAY, "terrain=step", cwd=tmp_path)
    assert done.code == 1
    assert "step" in done.out
    assert done.err == "error: out/table.tex: writing failed half way (No space left on device)\n"
    after = {p: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.is_file()}
    assert after == before


def test_a_full_disk_at_a_picture_costs_only_the_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = files.write_bytes

    def full(path: Path, data: bytes) -> None:
        if path.name == "flat.png":
            raise files.failure(path, OSError(errno.ENOSPC, "full"))
        write(path, data)

    monkeypatch.setattr("flipperctl.figures.figure.write_bytes", full)
    done = call(*PLAY, "terrain=flat,step", "--record", "mine.safetensors", cwd=tmp_path)
    assert done.code == 1
    assert "100 %" in done.out
    assert shown(tmp_path / "out") == {*TABLES, *CELLS, "step.png"}
    assert (tmp_path / "mine.safetensors").exists()
    (error,) = (line for line in done.err.splitlines() if line.startswith("error: "))
    assert "out/flat.png: writing failed half way (No space left on device)" in error


def test_what_a_kill_leaves_is_replaced_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(text: str, *names: str) -> Any:
        def into(part: Path) -> None:
            for name in names:
                (part / name).write_text(text)

        return into

    with result_folder(tmp_path, "eval", []) as folder:
        folder.replace(write("first", "a.csv", "b.csv", "old.csv"), later=["old.png"])
        (tmp_path / "old.png").write_text("first")

    replace = Path.replace

    def killed(self: Path, target: Path) -> Path:
        if target.name == "b.csv":
            raise KeyboardInterrupt
        return replace(self, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            ResultFolder(tmp_path, "eval").replace(write("second", "a.csv", "b.csv", "new.csv"))
    assert shown(tmp_path) == {"a.csv"}
    assert (tmp_path / "a.csv").read_text() == "second"
    with result_folder(tmp_path, "eval", []) as folder:
        folder.replace(write("third", "b.csv"))
    assert shown(tmp_path) == {"b.csv"}
    assert json.loads((tmp_path / ".results.json").read_text()) == {"eval": ["b.csv"]}


DIES = """
import os, sys
from pathlib import Path
from flipperctl.checkpoint.results import hold
context = hold(Path(sys.argv[1]))
context.__enter__()
os._exit(9)
"""


def dies_holding(folder: Path) -> None:
    """Run a process that ends without releasing the lock."""
    command = [sys.executable, "-c", DIES, str(folder)]
    assert subprocess.run(command, check=False, timeout=60).returncode == 9


def test_a_run_is_held_while_its_process_lives(tmp_path: Path) -> None:
    assert not is_held(tmp_path)
    with hold(tmp_path):
        assert is_held(tmp_path)
    assert not is_held(tmp_path)
    dies_holding(tmp_path)
    assert not is_held(tmp_path)
    with hold(tmp_path):  # nor does the lock of a process that died hold anyone up
        pass
