"""The documents of an evaluation are those that 0.1 wrote, byte by byte.

``recorded/`` holds what these commands wrote before results had types, the path of the policy cut
to its name; a change of a key or a number there breaks the readers of these documents. Since then,
only ends of intervals have changed (success rates are Wilson's, means Student's, null for fewer
than five values), and fields were added: ``controller`` and ``not_reached`` of a scene, ``beyond``
of ``passable``, ``success`` of a ``difference``.

- ``mix``: ``eval --controller level --baseline okada --passable okada,random terrain=mix
  'terrain.parts=[{name:step,low:0.9,high:0.9},{name:step,low:0.1,high:0.1},wave]' sim.friction=0.8
  --episodes 8``
- ``two``: ``eval --checkpoint generalist --baseline okada conditions=nominal,varied
  terrain=step,flat --episodes 3 --seed 77``
"""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from flipperctl.evaluation import files
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.results import EvaluationResult, SceneResult
from flipperctl.evaluation.scenes import compare
from flipperctl.evaluation.statistics import summarise
from tests.evaluation.samples import sample

pytestmark = pytest.mark.usefixtures("core_measures")

RECORDED = Path(__file__).parent / "recorded"
TEXTS = ("outcome", "terrain", "crossed_by")
COUNTS = ("episode", "seed", "decisions")
MARKS = ("scene", "controller", "conditions", "conditions_hash")


def episode(row: dict[str, str]) -> EpisodeResult:
    """Return the result of a recorded row."""
    values: dict[str, Any] = {k: v for k, v in row.items() if v != "" and k not in (*TEXTS, *MARKS)}
    values = {k: int(v) if k in COUNTS else float(v) for k, v in values.items()}
    more = {k: row[k] for k in ("outcome", "terrain")}
    return EpisodeResult.of(values.pop("episode"), {**values, **more})


def scene(document: dict[str, Any], rows: list[dict[str, str]], controller: str) -> SceneResult:
    """Return the result of a recorded scene, from its rows alone."""
    settings = dict(document["conditions"])
    conditions = Conditions(
        settings.pop("name"), {k: v for k, v in settings.items() if k != "hash"}, {}
    )
    mine = [row for row in rows if row["controller"] == controller]
    episodes = [episode(row) for row in mine]
    if "passable" in document:
        labels = [row["crossed_by"] for row in mine]
        episodes = [replace(e, crossed_by=label) for e, label in zip(episodes, labels, strict=True)]
    label = document["baseline"]["controller"]
    others = [episode(row) for row in rows if row["controller"] == label]
    terrain = document["terrain"]
    other = compare(terrain, episodes, label, others)
    summary = summarise(terrain, episodes)
    seed = document["seed"]
    return SceneResult(controller, summary, seed, conditions, (other,), tuple(episodes))


@pytest.mark.parametrize("name", ["mix", "two"])
def test_the_files_are_those_that_were_recorded(name: str, tmp_path: Path) -> None:
    text = (RECORDED / name / "summary.json").read_text()
    document = json.loads(text)
    lines = (RECORDED / name / "episodes.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    scenes = []
    for entry in document["scenes"]:
        key = (entry["terrain"], entry["conditions"]["hash"])
        own = [row for row in rows if (row["scene"], row["conditions_hash"]) == key]
        scenes.append(scene(entry, own, document["controller"]))
    result = EvaluationResult(tuple(scenes))
    assert json.dumps(result.to_dict(), indent=2) + "\n" == text
    files.write(tmp_path, result)
    for file in ("summary.json", "episodes.csv"):
        assert (tmp_path / file).read_bytes() == (RECORDED / name / file).read_bytes()


def test_a_row_holds_every_number_under_its_column() -> None:
    row = sample(7, "stuck", 2.0, "gap", crossed_by="").row()
    assert row == {
        "episode": 7,
        "seed": 7,
        "outcome": "stuck",
        "terrain": "gap",
        "decisions": 20,
        "t_cost": 20.0,
        "pitch_variation": 2.0,
        "pitch_variation_100hz": 4.0,
        "max_pitch": 0.2,
        "flipper_travel": 6.0,
        "return": -2.0,
        "reward_pitch": -2.0,
        "start_shift": 0.01,
        "crossed_by": "",
    }
    with pytest.raises(KeyError, match="t_cost"):
        EpisodeResult.of(0, {k: v for k, v in row.items() if k != "t_cost"})
