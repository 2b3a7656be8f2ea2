"""Standard output: with ``--json`` the document alone, and what any stream can show."""

import errno
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest
from rich.cells import cell_len

from flipperctl.cli.main import main
from flipperctl.process import entry
from flipperctl.text.show import console

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


def test_what_the_system_refuses_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def full() -> int:
        raise OSError(errno.ENOSPC, "")

    def many() -> int:
        raise OSError(errno.EMFILE, "", "some.csv")

    def memory() -> int:
        raise MemoryError("Unable to allocate 745. GiB")

    for program in (full, many, memory):
        with pytest.raises(SystemExit) as left:
            entry.run(program)
        assert left.value.code == 1
    assert capsys.readouterr().err.splitlines() == [
        "error: the system refuses: No space left on device",
        "error: some.csv: Too many open files",
        "error: there is not enough memory: Unable to allocate 745. GiB",
    ]


FLAT = ("eval", "--controller", "level", "--episodes", "1", "terrain=flat")


def call_encoded(monkeypatch: pytest.MonkeyPatch, encoding: str, *arguments: str) -> list[str]:
    """The lines on stdout of a command whose streams have this encoding."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])
    with pytest.raises(SystemExit) as left:
        main(arguments)
    streams[0].flush()
    assert left.value.code == 0
    buffer = streams[0].buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode(encoding).splitlines()


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_an_encoding_that_lacks_a_character_is_no_error(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    dash = "–" if encoding == "cp1252" else "?"  # which has it
    assert any(f"[{dash}]" in line for line in call_encoded(monkeypatch, encoding, *FLAT))


def test_a_pipe_gets_the_natural_width_or_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    all_columns = (*FLAT, "--columns", "all")
    assert max(map(cell_len, call_encoded(monkeypatch, "utf-8", *all_columns))) > 130
    monkeypatch.setenv("COLUMNS", "100")
    assert max(map(cell_len, call_encoded(monkeypatch, "utf-8", *all_columns))) <= 100
    monkeypatch.setenv("COLUMNS", "0")
    assert console().width > 1000
