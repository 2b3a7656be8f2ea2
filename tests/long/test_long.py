"""A few cases of ``python -m tests.long.kills`` and its like, which run hundreds."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow


def test_kills_races_and_stopped_sweeps_change_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.long.few"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("0 violations") == 4
