"""The table of results beside published ones."""

from typing import Any

from flipperctl.cli.scenes import scenes
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.views import evaluation
from flipperctl.evaluation.views.published import table
from tests.evaluation.samples import episodes, sample

ROWS = episodes([sample(i, "reached", v, t_cost=27.5) for i, v in enumerate((1.0, 1.5))])


def cells(*words: str, methods: tuple[str, ...] = ("",)) -> list[Any]:
    entries = [
        Entry(*scene, method=method) for scene in scenes(words, None, "okada") for method in methods
    ]
    played = tuple(Played(entry, ROWS) for entry in entries)
    found = table(evaluation.document(Result(Plan(tuple(entries)), played)))
    return [] if found is None else found.texts()


def test_the_papers_numbers_stand_below_ours_on_its_scenes() -> None:
    assert cells("conditions=paper", "terrain=paper_step,paper_stair,step") == [
        ["paper_step", "okada", "100 %", "27.50", "1.25", "0.50"],
        ["", "paper", "", "28.07", "3.43", "1.11"],
        ["paper_stair", "okada", "100 %", "27.50", "1.25", "0.50"],
        ["", "paper", "", "41.21", "4.53", "2.60"],
    ]


def test_other_conditions_or_another_scene_do_not_repeat_the_experiment() -> None:
    assert cells("terrain=paper_step") == []
    assert cells("conditions=paper", "terrain=paper_step", "terrain.platform=1") == []


def test_the_papers_conditions_are_three_dimensional_and_map_the_ground() -> None:
    ((config, _),) = scenes(["conditions=paper", "terrain=paper_step"], None, "okada")
    assert (config.sim.plugin_name, config.perception.plugin_name) == ("mujoco", "lidar")
    assert getattr(config.perception, "pose", None) == "matched"
    assert (config.robot.track_speed, config.conditions) == (0.2, "paper")


def test_each_policys_row_is_its_own() -> None:
    words = ("conditions=paper", "terrain=paper_step")
    rows = cells(*words, methods=("generalist", "level"))
    assert [row[1] for row in rows] == ["generalist", "paper", "level", "paper"]
