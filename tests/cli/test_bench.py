"""``flipperctl bench`` as a user types it."""

import io
import json
from pathlib import Path

import pytest

from flipperctl.bench.settings import SMALL, BenchSettings
from flipperctl.cli import bench
from flipperctl.terminal import bench as bench_output
from flipperctl.terminal.console import PlainConsole
from tests.cli.call import call
from tests.cli.test_errors import refused


def test_one_document_with_machine_settings_and_raw_numbers(tmp_path: Path) -> None:
    done = call(
        *("bench", "engines", "physics", "--small", "--json", "--repeats", "3"),
        *("terrain=step", "--output", "speed"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert json.loads((tmp_path / "speed" / "bench.json").read_text()) == document
    assert list(document["measures"]) == ["physics", "engines"]
    assert document["settings"]["repeats"] == 3
    assert document["overrides"] == ["terrain=step", "bench.repeats=3"]
    assert {"date", "versions", "processor", "cores", "load_average"} <= set(document["machine"])
    for found in document["measures"].values():
        assert all(len(q["values"]) == 3 for q in found["quantities"].values())


def test_people_get_a_table(tmp_path: Path) -> None:
    done = call("bench", "physics", "--small", "terrain=step", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "bare_decisions" in done.out
    assert "quartiles" in done.out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["speed"], ["'speed'", "physics", "key=value"]),
        (["phisics"], ["'phisics'", "did you mean 'physics'"]),
        (["bench.repeat=3"], ["bench.repeat", "'repeats'"]),
        (["--repeats", "1"], ["bench.repeats", "≥ 2", "1"]),
        (["bench.batch_sizes=[a]"], ["bench.batch_sizes", "'a'"]),
        (["bench.controller=okad"], ["bench.controller", "'okad'", "'okada'"]),
        (["terrain=stiar"], ["terrain", "'stiar'", "'stair'"]),
        (["seed=1,2"], ["one configuration", "2"]),
        (["--output", "file/x"], ["file/x", "cannot be written"]),
    ],
)
def test_a_wrong_request_is_refused(arguments: list[str], words: list[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    error = refused("bench", "--small", *arguments, cwd=tmp_path)
    assert [word for word in words if word not in error] == [], error


def test_measures_and_overrides_come_in_any_order() -> None:
    given = ["solve", "seed=2", "physics", "~rewards.pitch"]
    assert bench.split_arguments(given) == (["physics", "solve"], ["seed=2", "~rewards.pitch"])
    assert (
        bench.split_arguments([])[0]
        == bench.split_arguments(["all", "solve"])[0]
        == list(bench.MEASURES)
    )


def test_the_help_names_every_setting() -> None:
    for name in BenchSettings.model_fields:
        assert name in bench.HELP
    assert set(SMALL) <= set(BenchSettings.model_fields)


def test_an_unsolved_run_is_told_as_such() -> None:
    unsolved = {"unit": "s", "median": None, "low": None, "high": None, "values": [None]}
    document = {
        "settings": {"limit": 600.0},
        "measures": {
            "solve": {"about": "a", "quantities": {"sb3.seconds": unsolved}, "ratios": {}}
        },
    }
    (table,) = bench_output.tables(document)
    out = io.StringIO()
    table.print(PlainConsole(file=out, width=100))
    (row,) = (line for line in out.getvalue().splitlines() if "sb3.seconds" in line)
    assert [cell.strip() for cell in row.split("│")][2:4] == ["not within 600 s", "–"]


@pytest.mark.parametrize(
    ("value", "text"), [(0, "0"), (12345.6, "12,346"), (1.2345, "1.23"), (0.01234, "0.0123")]
)
def test_numbers_have_three_digits(value: float, text: str) -> None:
    assert bench_output.number(value) == text
