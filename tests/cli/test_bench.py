"""``flipperctl bench`` as a user types it."""

import json
from pathlib import Path

import pytest

from flipperctl.bench.measures import split_arguments
from flipperctl.bench.settings import BenchSettings
from flipperctl.cli import bench
from flipperctl.terminal import tables as bench_output
from tests.cli.call import call, refused


def test_one_document_with_machine_settings_and_raw_numbers(tmp_path: Path) -> None:
    done = call(
        *("bench", "learner", "engines", "--small", "--json", "--repeats", "3"),
        *("terrain=step", "--output", "speed"),
        cwd=tmp_path,
    )
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert json.loads((tmp_path / "speed" / "bench.json").read_text()) == document
    assert list(document["measures"]) == ["engines", "learner"]
    assert document["settings"]["repeats"] == 3
    assert document["overrides"] == ["terrain=step", "bench.repeats=3"]
    assert {"date", "versions", "processor", "cores", "load_average"} <= set(document["machine"])
    for found in document["measures"].values():
        assert all(len(q["values"]) == 3 for q in found["quantities"].values())


def test_people_get_a_table(tmp_path: Path) -> None:
    done = call("bench", "learner", "--small", "terrain=step", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "flipperctl.updates.32" in done.out
    assert "quartiles" in done.out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["speed"], ["'speed'", "engines", "key=value"]),
        (["latenzy"], ["'latenzy'", "did you mean 'latency'"]),
        (["solve"], ["'solve'", "clone", "python -m benchmarks solve"]),
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
    given = ["c", "seed=2", "a", "~rewards.pitch"]
    known = ("a", "b", "c")
    assert split_arguments(given, known) == (["a", "c"], ["seed=2", "~rewards.pitch"])
    for every in ([], ["all", "c"]):
        assert split_arguments(every, known) == (["a", "b", "c"], [])


def test_the_help_names_every_setting() -> None:
    assert [name for name in BenchSettings.model_fields if name not in bench.HELP] == []


def test_an_unsolved_run_is_told_as_such() -> None:
    unsolved = {"unit": "s", "median": None, "low": None, "high": None, "values": [None]}
    document = {
        "measures": {
            "solve": {
                "about": "a",
                "quantities": {"sb3.seconds": unsolved},
                "ratios": {},
                "unfinished": "not within 600 s",
            }
        },
    }
    (table,) = bench_output.tables(document)
    assert table.texts() == [["sb3.seconds", "not within 600 s", "–", "s"]]


@pytest.mark.parametrize(
    ("value", "text"), [(0, "0"), (12345.6, "12,346"), (1.2345, "1.23"), (0.01234, "0.0123")]
)
def test_numbers_have_three_digits(value: float, text: str) -> None:
    assert bench_output.number(value) == text
