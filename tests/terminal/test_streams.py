"""Standard output with ``--json``: the document alone, whatever plugins and processes print."""

import errno
import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from flipperctl import entry
from flipperctl.cli.main import run_app
from tests.cli.call import call

LOUD = """
import os
print("imported", flush=True)
from flipperctl.api import Profile, Terrain, terrain

@terrain("loud")
class Loud(Terrain):
    def generate(self, rng):
        print("generated")
        os.system("echo from a child process")
        return Profile([(0, 0), (0.3, 0.1), (0.6, 0)])
"""
EVAL = ["eval", "--controller", "level", "terrain=loud", "--plugins", "loud.py", "--episodes", "2"]


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command as a process of its own, whose streams have file descriptors."""
    (folder / "loud.py").write_text(LOUD)
    command = [sys.executable, "-m", "flipperctl", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_what_plugins_and_their_processes_print_goes_to_stderr(tmp_path: Path) -> None:
    done = run(tmp_path, *EVAL, "--jobs", "2", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["scenes"][0]["episodes"] == 2
    for printed in ("imported", "generated", "from a child process"):
        assert printed in done.stderr


def test_streams_without_file_descriptors_are_told_apart_as_well(tmp_path: Path) -> None:
    (tmp_path / "loud.py").write_text(LOUD.replace("os.system", "print"))
    words = ["inspect", "config", "terrain=loud", "--plugins", "loud.py"]
    done = call(*words, "--json", cwd=tmp_path)
    assert json.loads(done.out)["terrain"]["name"] == "loud"
    assert "imported" in done.err
    assert "imported" in call(*words, cwd=tmp_path).out  # tables do not mind


def test_an_error_of_the_system_is_one_of_standard_output_only_if_that_fails(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def full() -> int:
        raise OSError(errno.ENOSPC, "as of a semaphore in a full /dev/shm")

    def many() -> int:
        raise OSError(errno.EMFILE, "", "some.csv")

    for program in (full, many):
        with pytest.raises(SystemExit) as left:
            entry.run(program)
        assert left.value.code == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("error: No space left on device: ")
    assert "/dev/shm" in first
    assert "train.mode=exact" in first
    assert second == "error: some.csv: Too many open files"


def test_a_truncated_file_is_no_interruption() -> None:
    def read() -> None:
        raise EOFError("a plugin's file is cut off")

    app = typer.Typer()
    app.command()(read)
    with pytest.raises(EOFError, match="cut off"):
        run_app(app, [], "reader")


def test_closed_standard_streams_lead_nowhere(tmp_path: Path) -> None:
    script = f"exec {shlex.quote(sys.executable)} -m flipperctl inspect config terrain=flat"
    for closed in ("<&- >&-", "2>&-"):
        done = subprocess.run(
            ["sh", "-c", f"{script} {closed}"], cwd=tmp_path, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")
