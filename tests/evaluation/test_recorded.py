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
from pathlib import Path
from typing import Any

import pytest

from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.rows import Row, arranged
from flipperctl.evaluation.run import episode_rows
from flipperctl.evaluation.views import evaluation
from flipperctl.policies.source import PolicySource
from tests.evaluation.samples import entry, episodes, sample

pytestmark = pytest.mark.usefixtures("core_measures")

RECORDED = Path(__file__).parent / "recorded"
TEXTS = ("outcome", "terrain", "crossed_by")
COUNTS = ("episode", "seed", "decisions")
MARKS = ("scene", "controller", "conditions", "conditions_hash")


def episode(row: dict[str, str]) -> Row:
    """Return a recorded row with its numbers."""
    values: dict[str, Any] = {k: v for k, v in row.items() if v != "" and k not in (*TEXTS, *MARKS)}
    values = {k: int(v) if k in COUNTS else float(v) for k, v in values.items()}
    return arranged(values | {k: row[k] for k in ("outcome", "terrain")})


def played(document: dict[str, Any], rows: list[dict[str, str]], label: str) -> list[Played]:
    """Return a recorded scene and its baseline, from its rows alone."""
    settings = {k: v for k, v in document["conditions"].items() if k not in ("name", "hash")}
    conditions = Conditions(document["conditions"]["name"], settings, {})
    found = []
    for name in (label, document["baseline"]["controller"]):
        mine = [row for row in rows if row["controller"] == name]
        own = [episode(row) for row in mine]
        if "passable" in document and name == label:
            own = [o | {"crossed_by": r["crossed_by"]} for o, r in zip(own, mine, strict=True)]
        config = entry(name, document["terrain"]).config
        numbers = config.eval.model_copy(update={"seed": document["seed"]})
        config = config.model_copy(update={"eval": numbers})
        one = Entry(config, PolicySource(settings={"name": name}), is_baseline=name != label)
        one.__dict__["conditions"] = conditions
        found.append(Played(one, episodes(own)))
    return found


@pytest.mark.parametrize("name", ["mix", "two"])
def test_the_files_are_those_that_were_recorded(name: str) -> None:
    text = (RECORDED / name / "summary.json").read_text()
    document = json.loads(text)
    lines = (RECORDED / name / "episodes.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    every: list[Played] = []
    for scene in document["scenes"]:
        key = (scene["terrain"], scene["conditions"]["hash"])
        own = [row for row in rows if (row["scene"], row["conditions_hash"]) == key]
        every += played(scene, own, document["controller"])
    result = Result(Plan(tuple(one.entry for one in every)), tuple(every))
    assert json.dumps(evaluation.document(result), indent=2) + "\n" == text
    found = [{k: str(v) for k, v in row.items()} for row in episode_rows(result)]
    assert found == [{k: v for k, v in row.items() if v != "" or k in one} for row, one in
                     zip(rows, found, strict=True)]  # fmt: skip
    assert list(found[0]) == [name for name in lines[0].split(",") if name in found[0]]


def test_a_row_holds_every_number_under_its_column() -> None:
    row = sample(7, "stuck", 2.0, "gap", crossed_by="")
    assert list(row) == [
        *("episode", "seed", "outcome", "terrain", "decisions", "t_cost", "pitch_variation"),
        *("pitch_variation_100hz", "max_pitch", "flipper_travel", "return", "reward_pitch"),
        *("start_shift", "crossed_by"),
    ]
