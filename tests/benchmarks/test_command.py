"""``python -m benchmarks`` as a developer types it."""

import contextlib
import json
from pathlib import Path

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks.settings import MEASURES, BenchmarkSettings
from flipperctl.bench.measures import MOVED
from flipperctl.cli.main import run_app


def run(*arguments: str) -> int:
    return run_app(benchmarks.app, list(arguments), "benchmarks")


def test_a_measure_runs_with_settings_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with contextlib.chdir(tmp_path):
        code = run("physics", "--small", "--json", "--output", "speed", "bench.limit=3")
    assert code == 0
    document = json.loads(capsys.readouterr().out)
    assert json.loads((tmp_path / "speed" / "bench.json").read_text()) == document
    assert document["settings"]["limit"] == 3.0
    assert "bare_decisions" in document["measures"]["physics"]["quantities"]


def test_what_moved_is_here_and_the_help_names_every_measure_and_setting() -> None:
    assert set(MOVED) <= set(MEASURES)
    names = (*MEASURES, *BenchmarkSettings.model_fields)
    assert [name for name in names if name not in benchmarks.HELP] == []
