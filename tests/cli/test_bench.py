"""``flipperctl bench`` as a user types it, and its statistics by hand."""

import json
import subprocess
import sys
from pathlib import Path

from flipperctl import bench
from flipperctl.cli.train import split_arguments
from tests.cli.call import call


def test_one_document_with_machine_settings_and_raw_numbers(tmp_path: Path) -> None:
    words = ("bench", "--small", "--json", "--output", "speed", "terrain=step")
    done = call(*words, "train.mode=exact", cwd=tmp_path)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert json.loads((tmp_path / "speed" / "bench.json").read_text()) == document
    assert {"date", "versions", "processor", "cores", "load_average"} <= set(document["machine"])
    found = [q for one in document["measures"].values() for q in one["quantities"].items()]
    assert {name: q["unit"] for name, q in found if "demo" not in name} == {
        "training": "1/s",
        "evaluation.mujoco": "-",
        "evaluation.planar": "-",
        "decision.median": "µs",
        "decision.p99": "µs",
    }
    assert all(len(q["values"]) == 2 and min(q["values"]) > 0 for _, q in found)


def test_decisions_are_timed_without_torch_and_pymunk() -> None:
    code = "import sys, flipperctl.bench as b; print([n for n in b.HEAVY if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_measures_and_overrides_come_in_any_order() -> None:
    given = ["c", "seed=2", "a", "~rewards.pitch"]
    known = ("a", "b", "c")
    assert split_arguments(given, known) == (["a", "c"], ["seed=2", "~rewards.pitch"])
    for every in ([], ["all", "c"]):
        assert split_arguments(every, known) == (["a", "b", "c"], [])


def test_an_unsolved_run_is_told_as_such() -> None:
    unsolved = {"unit": "s", "median": None, "low": None, "high": None, "values": [None]}
    found = {"about": "a", "quantities": {"sb3": unsolved}, "unfinished": "not within 600 s"}
    assert bench.table("solve", found).texts() == [["sb3", "not within 600 s", "–", "s"]]
