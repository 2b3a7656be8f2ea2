"""The document and the tables of an evaluation.

The documents are those that 0.1 wrote, byte by byte. ``recorded/`` holds what these commands wrote
before results had types, the path of the policy cut to its name; a change of a key or a number
there breaks the readers of these documents. Since then, only ends of intervals have changed
(success rates are Wilson's, means Student's, null for fewer than five values), and fields were
added: ``controller`` and ``not_reached`` of a scene, ``beyond`` of ``passable``, ``success`` of a
``difference``.

- ``mix``: ``eval --controller level --baseline okada --passable okada,random terrain=mix
  'terrain.parts=[{name:step,height:0.9},{name:step,height:0.1},wave]' sim.friction=0.8
  --episodes 8``
- ``two``: ``eval --checkpoint generalist --baseline okada conditions=nominal,varied
  terrain=step,flat --episodes 3 --seed 77``
"""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from flipperctl.config import EvalConfig
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.rows import Row, arranged
from flipperctl.evaluation.statistics import Interval
from flipperctl.policies.source import PolicySource
from flipperctl.requests.evaluation import episode_rows
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.requests.traces import choose
from flipperctl.text.files import write_csv
from flipperctl.text.show import interval_text, latex
from flipperctl.views import evaluation
from flipperctl.views.evaluation import csv_rows, document, parse_columns, parse_groups, policies
from flipperctl.views.findings import findings
from flipperctl.views.published import published
from flipperctl.views.summary import named
from tests.evaluation.samples import entry, episodes, sample
from tests.evaluation.samples import result as made

pytestmark = pytest.mark.usefixtures("core_measures")


def result() -> Result:
    """Return the result of a policy that reached the finish five times, its baseline once."""
    ours = [sample(i, "reached", value) for i, value in enumerate((1.0, 2.0, 3.0, 4.0, 5.0))]
    theirs = [sample(i, "stuck" if i else "reached", 2.0 + i) for i in range(5)]
    return made(ours, {"level": theirs}, label="a&b_50%")


def test_a_mean_without_an_interval_has_a_dash() -> None:
    found = Interval(1.984, 1.5, 2.0)
    assert interval_text(found.to_dict()) == "1.98 [1.50, 2.00]"
    assert interval_text(found.to_dict(), 1, sign="+") == "+2.0 [+1.5, +2.0]"
    assert interval_text(Interval(1.984, None, None).to_dict()) == "1.98 [–]"
    assert interval_text(None) == "–"


def test_the_csv_has_a_row_for_each_scene_and_method(tmp_path: Path) -> None:
    found = document(result())
    write_csv(tmp_path / "table.csv", list(csv_rows(found, 4)))
    ours, theirs = csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text()))
    digest = found["scenes"][0]["conditions"]["hash"]
    # Of 1 to 5 the half width of the interval is 2.776445 · √(2.5 / 5) = 1.9632.
    assert ours == {
        "scene": "step", "method": "a&b_50%", "controller": "a&b_50%", "n": "5", "reached": "5",
        "success": "1.0", "success_low": "0.5655", "success_high": "1.0",
        "t_cost": "30.0", "t_cost_low": "10.3676", "t_cost_high": "49.6324",
        "pitch_variation_100hz": "6.0",
        "pitch_variation_100hz_low": "2.0735", "pitch_variation_100hz_high": "9.9265",
        "pitch_variation_decisions": "3.0",
        "pitch_variation_decisions_low": "1.0368", "pitch_variation_decisions_high": "4.9632",
        "max_pitch": "0.3", "max_pitch_low": "0.1037", "max_pitch_high": "0.4963",
        "flipper_travel": "9.0", "flipper_travel_low": "3.1103", "flipper_travel_high": "14.8897",
        "not_reached_pitch_variation_100hz": "",
        "not_reached_pitch_variation_100hz_low": "", "not_reached_pitch_variation_100hz_high": "",
        "seed": "0", "conditions": "nominal", "conditions_hash": digest,
    }  # fmt: skip
    assert (theirs["method"], theirs["n"], theirs["reached"]) == ("level", "5", "1")
    # One episode reached the finish, so its mean has no interval; the largest pitch is of all.
    assert (theirs["t_cost"], theirs["t_cost_low"], theirs["t_cost_high"]) == ("20.0", "", "")
    assert (theirs["max_pitch"], theirs["max_pitch_low"]) == ("0.4", "0.2037")
    assert theirs["not_reached_pitch_variation_100hz"] == "9.0"  # of 6, 8, 10 and 12


def test_the_table_has_what_a_reader_needs_and_baselines_are_rows() -> None:
    table, *others = evaluation.tables(document(result()), "a&b_50%")
    assert others == []
    assert table.title == "a&b_50% on step · 5 episodes"
    assert [column.heading for column in table.columns] == [
        *("policy", "success", "failures", "pitch variation [rad]", "time [s]")
    ]
    assert table.texts() == [
        ["a&b_50%", "100 % [56.6, 100]", "", "6.00 [2.07, 9.93]", "30.0"],
        ["level", "20 % [3.62, 62.4]", "4 stuck", "4.00 [–]", "20.0"],
    ]
    # Both reached with seed 0 alone, with 2 and 4 rad; four won, none lost: p = 2 / 2^4.
    assert table.notes == [
        "against level, same episodes: pitch variation -2.00 rad, success +80 % (p 0.125)"
    ]


def test_further_columns_are_chosen_by_name() -> None:
    table = policies(document(result()), "mine", parse_columns("max_pitch,episodes"))
    assert [column.key for column in table.columns][-2:] == ["max_pitch", "episodes"]
    assert "return" in parse_columns("all")
    assert parse_columns(None) == []


def test_the_tabular_escapes_names_and_needs_one_package() -> None:
    lines = latex(policies(document(result()), "mine")).splitlines()
    assert lines[0] == r"% needs \usepackage{booktabs}"
    assert lines[1] == "% mine on step · 5 episodes"
    assert lines[3] == r"\begin{tabular}{@{}llrrr@{}}"
    assert lines[7] == (r"a\&b\_50\% & 100 \% [56.6, 100] &  & 6.00 [2.07, 9.93] & 30.0 \\")
    assert lines[8] == r"level & 20 \% [3.62, 62.4] & 4 stuck & 4.00 [--] & 20.0 \\"
    assert lines[9:] == [r"\bottomrule", r"\end{tabular}}"]


def test_training_seeds_of_a_method_are_pooled_and_compared() -> None:
    values = ((1.0, 1.2, 1.1, 1.3, 1.0), (1.4, 1.6, 1.5, 1.7, 1.4), (1.2, 1.4, 1.3, 1.5, 1.2))
    entries, played = [], []
    for seed, own in enumerate(values):
        one = replace(entry(f"run{seed}"), method="mine", training_seed=seed)
        entries.append(one)
        played.append(Played(one, episodes([sample(i, "reached", v) for i, v in enumerate(own)])))
    level = PolicySource(settings={"name": "level"})
    other = replace(entries[0], source=level, method="level", training_seed=None, is_baseline=True)
    rows = episodes([sample(i, "reached", 2.0 + v) for i, v in enumerate(values[0])])
    found = document(Result(Plan((*entries, other)), (*played, Played(other, rows))))
    (method,) = found["methods"]
    assert (method["seeds"], method["episodes"], method["success_rate"]) == (3, 5, 1.0)
    # Means of the seeds at 100 Hz: 2.24, 3.04 and 2.64; the baseline's is 2 · (2 + 1.12).
    assert method["pitch_variation_100hz"]["mean"] == pytest.approx(2.64)
    gap = method["baselines"][0]["difference"]["pitch_variation_100hz"]
    assert gap["mean"] == pytest.approx(2.64 - 6.24)
    table = policies(found, "mine")
    assert [row["policy"] for row in table.rows] == ["mine (3 seeds)", "level"]
    stuck = episodes([sample(i, "stuck", 9.0) for i in range(5)])  # one seed of three, and level
    played = [*played[:2], Played(entries[2], stuck), Played(other, stuck)]
    plan = Plan((*entries, other))
    (method,) = document(Result(plan, tuple(played)))["methods"]
    difference = method["baselines"][0]["difference"]
    assert difference["success"]["mean"] == pytest.approx(2 / 3)
    assert difference["pitch_variation_100hz"] is None
    # Two of three seeds fail in all 5 episodes: no episode was reached by all, two are traced.
    fail = Result(plan, (played[0], *(Played(e, stuck) for e in entries[1:]), Played(other, rows)))
    found = document(fail)
    assert policies(found, "mine").title == "mine on step · 5 episodes of each seed"
    clear = {("step", "mine (3 seeds)", "level"): Interval(4.0, 3.0, 5.0).to_dict()}
    told = [text for _, text in findings(found, clear)]
    assert "Worse than **level**, flippers held still: **mine (3 seeds)** on step (" in told[2]
    assert told[-1].startswith("10 of 20 episodes failed, counted for each training seed: **mine")
    traced = [(item.policy, item.row["episode"]) for item in choose(fail, found)]
    assert traced[8:] == [("mine, seed 1", 1)]  # beside the first and the telling episode of each


def test_scenes_of_a_terrain_are_told_apart_by_what_differs() -> None:
    def scene(name: str, sim: str, digest: str) -> dict[str, object]:
        section = {"name": sim}
        conditions = {"name": name, "hash": digest, "sim": section, "perception": section}
        return {"terrain": "step", "conditions": conditions}

    two = [scene("nominal", "planar", "a"), scene("varied", "planar", "b")]
    assert [name for name, _ in named({"scenes": two})] == ["step, nominal", "step, varied"]
    alike = [scene("nominal", "planar", "a"), scene("nominal", "planar", "b")]
    assert [name for name, _ in named({"scenes": alike})] == ["step, a", "step, b"]
    same = [two[0], two[0]]
    assert [name for name, _ in named({"scenes": same})] == ["step (1)", "step (2)"]


ROWS = episodes([sample(i, "reached", v, t_cost=27.5) for i, v in enumerate((1.0, 1.5))])


def beside_published(*words: str) -> list[Any]:
    entries = [Entry(*scene) for scene in scenes(from_words(words), None, "okada")]
    played = tuple(Played(entry, ROWS) for entry in entries)
    found = published(evaluation.document(Result(Plan(tuple(entries)), played)))
    return [] if found is None else found.texts()


def test_the_papers_numbers_stand_below_ours_on_its_scenes() -> None:
    assert beside_published("conditions=paper", "terrain=paper_step,paper_stair,step") == [
        ["paper_step", "okada", "100 %", "27.50", "1.25", "0.50"],
        ["", "AT-D3QN (paper)", "", "28.07", "3.43", "1.11"],
        ["", "operators (paper)", "", "46.17", "4.02", "2.92"],
        ["paper_stair", "okada", "100 %", "27.50", "1.25", "0.50"],
        ["", "AT-D3QN (paper)", "", "41.21", "4.53", "2.60"],
        ["", "operators (paper)", "", "76.53", "6.30", "3.88"],
    ]


def test_other_conditions_or_another_scene_do_not_repeat_the_experiment() -> None:
    assert beside_published("terrain=paper_step") == []
    assert beside_published("conditions=paper", "terrain=paper_step", "terrain.platform=1") == []


STEPS = (3, 3, 3, 3, 3, 12, 12)


def drawn_result(numbers: list[dict[str, float]]) -> Result:
    """Return episodes that drew these numbers; the baseline's θ̂_R is 0.5 rad smaller."""

    def rows(first: float) -> list[dict[str, Any]]:
        drawn = [{f"drawn_{name}": value for name, value in one.items()} for one in numbers]
        return [sample(i, "reached", first + i, **one) for i, one in enumerate(drawn)]

    return made(rows(3.0), {"level": rows(2.5)}, terrain="stair")


def groups(numbers: list[dict[str, float]], *names: str) -> list[dict[str, Any]]:
    (scene,) = evaluation.document(drawn_result(numbers), [names])["scenes"]
    found: list[dict[str, Any]] = scene["by"]["+".join(names)]
    return found


def ranges(group: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (ends["low"], ends["high"]) for name, ends in group["drawn"].items()}


def test_many_values_are_split_at_their_quartiles() -> None:
    found = groups([{"slope": 20.0 + i} for i in range(12)], "slope")
    drawn = [ranges(group)["slope"] for group in found]
    assert drawn == [(20, 22), (23, 25), (26, 28), (29, 31)]
    assert [group["episodes"] for group in found] == [3, 3, 3, 3]


def test_combinations_and_samples_group_too_and_other_ground_is_left_out() -> None:
    numbers = [{"steps": 3, "up": i % 2} for i in range(6)] + [{"height": 0.2}]
    found = groups(numbers, "steps", "up")
    assert [ranges(g) for g in found] == [
        {"steps": (3, 3), "up": (0, 0)},
        {"steps": (3, 3), "up": (1, 1)},
    ]
    assert [g["episodes"] for g in found] == [3, 3]
    (every,) = groups(numbers, "start_shift")  # a sampled value, the same in all
    assert every["episodes"] == 7


def test_the_document_and_the_table_have_a_row_for_each_group() -> None:
    found = evaluation.document(drawn_result([{"steps": steps} for steps in STEPS]), [("steps",)])
    (scene,) = found["scenes"]
    short, long = scene["by"]["steps"]
    assert short["drawn"] == {"steps": {"low": 3, "high": 3}}
    assert long["episodes"] == 2
    assert long["baseline"]["difference"]["pitch_variation_decisions"]["mean"] == 0.5
    (shown,) = evaluation.group_tables("stair", scene, "mine")
    assert shown.title == "mine on stair by steps"
    assert [text[:2] for text in shown.texts()] == [["3", "5"], ["12", "2"]]
    assert shown.texts()[0][-1] == "+1.00 [–]"  # at 100 Hz
    assert "by" not in evaluation.document(drawn_result([{"steps": 3}]))["scenes"][0]


def test_names_are_checked_before_an_episode_is_played() -> None:
    scenes = [EvalConfig(terrain="flat"), EvalConfig(terrain="building_stair")]
    assert parse_groups("steps, slope+up,start_shift", "--by", scenes) == [
        ("steps",),
        ("slope", "up"),
        ("start_shift",),
    ]
    assert parse_groups(None, "--by", scenes) == []
    varied = EvalConfig(terrain="flat", randomise={"sim": {"friction": (0.6, 1.2)}})
    assert parse_groups("sim.friction", "--by", [varied]) == [("sim.friction",)]


RECORDED = Path(__file__).parents[1] / "evaluation/recorded"
TEXTS = ("outcome", "terrain", "crossed_by")
COUNTS = ("episode", "seed", "decisions")
MARKS = ("scene", "method", "controller", "conditions", "conditions_hash")


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
        *(
            "episode",
            "seed",
            "outcome",
            "terrain",
            "decisions",
            "t_cost",
            "pitch_variation_decisions",
        ),
        *("pitch_variation_100hz", "max_pitch", "flipper_travel", "return", "reward_pitch"),
        *("start_shift", "crossed_by"),
    ]
