"""The results of everything that ships: from folders of evaluations to rows and tables."""

import csv
import json
import math
from pathlib import Path
from typing import Any

import pytest

from benchmarks import shipped
from benchmarks.shipped_table import markdown
from flipperctl.errors import RequestError

TURN = 2 * math.pi
"""The score of an episode that was not reached [rad]."""


def write(folder: Path, policies: dict[str, tuple[str, list[float | None]]]) -> None:
    """Write what ``eval --output`` does: label → method and θ̂_R of its episodes, None: stuck."""
    folder.mkdir()
    scenes: list[dict[str, Any]] = []
    with (folder / "episodes.csv").open("w", newline="") as file:
        names = ("controller", "conditions_hash", "episode", "outcome")
        table = csv.writer(file)
        table.writerow([*names, "pitch_variation_100hz", "pitch_variation", "t_cost"])
        for label, (method, swings) in policies.items():
            for case, count in (("5 repeats", 5), ("all", len(swings))):
                conditions = {"hash": "abcd", "sim": {"name": "planar"}}
                row = {"terrain": "step", "conditions": conditions, "episodes": count}
                scenes.append({**row, "suite_scene": case, "method": method, "controller": label})
                for index, swing in enumerate(swings[:count]):
                    outcome = "stuck" if swing is None else "reached"
                    table.writerow([label, "abcd", index, outcome, swing or 9.0, swing or 9.0, 20])
    (folder / "summary.json").write_text(json.dumps({"scenes": scenes}))


def test_rows_have_all_training_seeds_and_count_failures(tmp_path: Path) -> None:
    first: list[float | None] = [1.0, 1.0, 1.0, 1.0, 1.0, 3.0]
    other = [2.0, 2.0, 2.0, 2.0, 2.0, None]
    plain = {"0": ("runs/plain/0", first), "1": ("runs/plain/1", other)}  # of unequal settings
    write(tmp_path / "fast", {**plain, "level": ("level", [2.0] * 6)})
    write(tmp_path / "mpc", {"mpc": ("mpc", [0.5] * 5)})
    found = shipped.results([tmp_path / "fast", tmp_path / "mpc"], Path("runs"))
    rows = {(row["method"], row["case"]): row for row in found["scenes"]}
    assert list(rows) == [
        *(("plain", case) for case in ("5 repeats", "all")),
        *(("level", case) for case in ("5 repeats", "all")),
        ("mpc", "5 repeats"),  # "all" repeats the same five
    ]
    row = rows["plain", "all"]
    assert (row["seeds"], row["episodes"], row["success"][0]) == (2, 6, 0.916667)
    assert row["score"][0] == pytest.approx((8 + 10 + TURN) / 12, abs=1e-5)
    assert row["pitch_variation_100hz"] == pytest.approx(18 / 11, abs=1e-5)
    overview = {row["method"]: row for row in found["overview"]}
    assert overview["plain"]["episodes"] == [6]  # of equal conditions, the larger number counts
    assert overview["plain"]["difference"][0] == pytest.approx(row["score"][0] - 2, abs=1e-5)
    assert overview["mpc"]["difference"] == [-1.5, None, None]  # on its own five, equal episodes
    assert overview["level"]["difference"] is None
    assert markdown(found, ["scenes"])[2:] == [
        "| `step`, 5 repeats | 1.50 (100 %) | 2.00 (100 %) | 0.50 (100 %) |",
        "| `step`, all | 2.02 (92 %) | 2.00 (100 %) | – |",
    ]
    assert markdown(found, ["overview"])[-1] == (
        "| `mpc` | – | 1 | 5 | 1.000 [0.566, 1.000] | 0.50 | 0.50 | -1.50 |"
    )
    with pytest.raises(RequestError, match="no such table; known: trainings, overview"):
        markdown(found, ["swing"])


def test_a_method_with_more_episodes_than_level_is_compared_on_those_of_both(
    tmp_path: Path,
) -> None:
    write(tmp_path / "fast", {"level": ("level", [2.0] * 5)})
    write(tmp_path / "mpc", {"mpc": ("mpc", [0.5] * 5 + [9.0])})
    found = shipped.results([tmp_path / "fast", tmp_path / "mpc"], Path("runs"))
    (row,) = [row for row in found["overview"] if row["method"] == "mpc"]
    assert row["difference"][0] == -1.5


def test_trainings_are_stated_as_they_were_made(tmp_path: Path) -> None:
    for number, words in enumerate(("a=1, seed=1", "a=1, seed=2", "a=2, seed=3")):
        folder = tmp_path / "plain" / str(number) / ".hydra"
        folder.mkdir(parents=True)
        (folder / "overrides.yaml").write_text(f"[{words}]")
    found = shipped.trainings(tmp_path)
    assert markdown({"trainings": found}, ["trainings"])[2:] == [
        "| `plain` | `a=1 seed=1,2` |",
        "| `plain` | `a=2 seed=3` |",
    ]


def test_the_calls_name_the_trainings_that_exist(tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=r"run flipperctl train -m terrain=all_kinds seed=1,2,3"):
        list(shipped.calls(tmp_path, tmp_path, 1, shipped.Numbers()))
    (tmp_path / "searched").mkdir()
    calls = list(shipped.calls(tmp_path, Path("judged"), 2, shipped.Numbers(30, 5)))
    assert len(calls) == 3 * len(shipped.SUITES)
    suite, words = calls[3]
    assert suite == "families"
    assert words == (
        "eval suite=families --baseline none --jobs 2 eval.cell=5 "
        f"--checkpoint {tmp_path / 'searched'} --checkpoint generalist "
        "--controller okada,level "
        "--episodes 30 --output judged/families/fast"
    )
