"""The table of results beside published ones."""

from typing import Any

from flipperctl.cli.scenes import scenes
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.results import EvaluationResult, SceneResult
from flipperctl.evaluation.statistics import summarise
from flipperctl.terminal.published import published_table
from tests.evaluation.samples import sample


def result(*words: str) -> EvaluationResult:
    found = []
    for config, _ in scenes(words, None, "okada"):
        episodes = [sample(i, "reached", v, t_cost=27.5) for i, v in enumerate((1.0, 1.5))]
        summary = summarise(config.terrain.plugin_name, episodes)
        scene = SceneResult("okada", summary, 0, Conditions.of(config), (), tuple(episodes))
        found.append(scene)
    return EvaluationResult(tuple(found))


def cells(*words: str) -> list[Any]:
    table = published_table(result(*words), "okada")
    return [] if table is None else [row for row, _ in table._rows]


def test_the_papers_numbers_stand_below_ours_on_its_scenes() -> None:
    assert cells("conditions=paper", "terrain=paper_step,paper_stair,step") == [
        ["paper_step", "okada", "2", "1.000", "27.50", "1.25", "0.50"],
        ["", "paper", "", "", "28.07", "3.43", "1.11"],
        ["paper_stair", "okada", "2", "1.000", "27.50", "1.25", "0.50"],
        ["", "paper", "", "", "41.21", "4.53", "2.60"],
    ]


def test_other_conditions_or_another_scene_do_not_repeat_the_experiment() -> None:
    assert cells("terrain=paper_step") == []
    assert cells("conditions=paper", "terrain=paper_step", "terrain.platform=1") == []


def test_the_papers_conditions_are_three_dimensional_and_map_the_ground() -> None:
    ((config, _),) = scenes(["conditions=paper", "terrain=paper_step"], None, "okada")
    assert (config.sim.plugin_name, config.perception.plugin_name) == ("mujoco", "lidar")
    assert getattr(config.perception, "pose", None) == "matched"
    assert (config.robot.track_speed, config.conditions) == (0.2, "paper")
