"""How much code there is, and how much of it one command runs.

    python -m benchmarks.size [--trace "eval okada terrain=stair --episodes 3"]

It prints the lines and files of each part, the floors of the import contract, and for each
command the files of the package in which it runs code.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from flipperctl.process import entry

ROOT = Path(__file__).parents[1]
PARTS = ("flipperctl", "plugins", "tests", "benchmarks", "examples")
COMMANDS = (
    "eval okada terrain=stair --episodes 3",
    "train terrain=stair experiment=quick train.mode=exact train.decisions=300 "
    "agent.learning_starts=100 train.validation_episodes=1 train.regret_episodes=1",
)
_TRACER = """
import sys
files = set()
def note(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & 1:  # a function, no body of a module or class
        files.add(frame.f_code.co_filename)
sys.setprofile(note)
from flipperctl.cli.main import main
try:
    main(sys.argv[2:])
except SystemExit as ended:
    if ended.code:
        raise
sys.setprofile(None)
own = {name for name in files if name.startswith(sys.argv[1])}
print(len(own), file=sys.stderr)
"""


def lines(part: str) -> tuple[int, int]:
    """Return the numbers of lines and of files of Python below a folder."""
    files = [file for file in (ROOT / part).rglob("*.py") if "__pycache__" not in file.parts]
    return sum(file.read_text("utf-8").count("\n") for file in files), len(files)


def floors() -> int:
    """Return the number of layers of the package in the import contract."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    (layers,) = (c["layers"] for c in settings["contracts"] if c["type"] == "layers")
    return len(layers)


def files_run(command: str) -> int:
    """Return the number of the package's files in which a command runs code.

    Module bodies and worker processes are left out.
    """
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(  # noqa: S603  # words of this file or of its user
            [sys.executable, "-c", _TRACER, str(ROOT / "flipperctl"), *command.split()],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        )
    return int(done.stderr.split()[-1])


def main() -> int:
    """Print the sizes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.size", description=__doc__)
    parser.add_argument("--trace", action="append", help="a command, in place of the default ones")
    asked = parser.parse_args()
    for part in PARTS:
        count, files = lines(part)
        print(f"{part:<12} {count:>6} lines in {files:>3} files")
    print(f"floors: {floors()}")
    for command in asked.trace or COMMANDS:
        print(f"{files_run(command)} files: flipperctl {command}")
    return 0


if __name__ == "__main__":
    entry.run(main)
