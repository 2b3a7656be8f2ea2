"""A few cases of ``python -m tests.long.kills`` and its like, which run hundreds."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.long import golden

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


def test_golden_runs_commands_apart_and_lists_what_differs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = {"command": "train terrain=stiar", "python": 'flipperctl.load("nope")'}
    done = golden.run(jobs | {"function": lambda: {"a": [1, {"seconds": 2}]}}, tmp_path)
    assert [one.code for one in done.values()] == [2, 2, 0]
    assert "'stair'" in done["command"].err
    assert done["python"].err.startswith("ConfigError: policy: ")
    entries = golden.document("function", done["function"])
    assert entries == {"function/a/0": 1}
    assert not golden.compare("part", entries, {**entries, "b": 1})
    assert golden.compare("part", {**entries, "c": 2}, {"function/a/0": 1.5})
    out = capsys.readouterr().out
    assert "part: 1 equal, 0 changed, 0 missing, 1 new" in out
    assert "changed function/a/0: 1 → 1.5\n  missing c: 2\n" in out
