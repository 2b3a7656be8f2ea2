"""A few cases of ``python -m tests.long.kills`` and its like, which run hundreds."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "command",
    [
        ["kills", "--count", "2", "--early", "1", "--fast", "0"],
        ["races", "--count", "2", "--fast", "0"],
        ["killed_sweeps", "--count", "1", "--joblib", "0", "--stops", "SIGKILL"],
    ],
    ids=["kills", "races", "killed sweeps"],
)
def test_kills_and_races_change_nothing(command: list[str]) -> None:
    name, *options = command
    done = subprocess.run(
        [sys.executable, "-m", f"tests.long.{name}", *options, "--seed", "5"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 violations" in done.stdout
