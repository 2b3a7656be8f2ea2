"""Standard output with ``--json``: the document alone, whatever plugins and processes print."""

import json
import subprocess
import sys
from pathlib import Path

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


def test_a_document_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "flipperctl", "inspect", "config", "--json"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: standard output cannot be written: No space left on device\n"
