"""A policy on scenes, beside a baseline and references that try what it fails."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from flipperctl.config import EvalConfig
from flipperctl.errors import InterruptedRunError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.evaluate import evaluate as play
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.statistics import holm, paired_success, proportion
from flipperctl.evaluation.views import evaluation
from flipperctl.policies.source import PolicySource, load_policy

LEVEL, OKADA, RANDOM = (load_policy(name, "here") for name in ("level", "okada", "random"))
TWO = {"episodes": 2, "seed": 4}
STEP = EvalConfig(terrain={"name": "step", "low": 0.4, "high": 0.4}, eval=TWO)
"""Flippers held level stop at it, okada climbs it, random ones overturn the robot."""
FLAT = EvalConfig(terrain="flat", eval=TWO)
"""On it okada holds its flippers level too."""


def evaluate(
    scenes: Sequence[tuple[EvalConfig, PolicySource]],
    baselines: Sequence[PolicySource] = (),
    **more: Any,
) -> Result:
    return play(Plan.of_one([Entry(*scene) for scene in scenes], baselines), **more)


def documents(found: Result) -> list[dict[str, Any]]:
    scenes: list[dict[str, Any]] = evaluation.document(found)["scenes"]
    return scenes


def passable(episodes: int, crossed: int, beyond: int = 0) -> dict[str, Any]:
    success = proportion(crossed, episodes)
    rates = {"success_rate": success.mean, "success": success.to_dict()}
    tried = {"references": ["random", "okada"]}
    return {"episodes": episodes, **rates, "beyond": beyond, **tried}


def test_a_baseline_and_references_play_the_episodes_of_each_scene() -> None:
    scenes = [(STEP, LEVEL), (FLAT, LEVEL)]
    found = evaluate(scenes, [OKADA, RANDOM], references=[RANDOM, OKADA])
    step_played, flat_played = found.rows
    assert step_played.episodes[0]["seed"] != flat_played.episodes[0]["seed"]
    assert [row["crossed_by"] for row in step_played.episodes] == ["okada", "okada"]
    assert [row["crossed_by"] for row in flat_played.episodes] == ["random", "random"]
    others = [row for one in found.baselines(flat_played) for row in one.episodes]
    assert not any("crossed_by" in row for row in others)
    alone = evaluate([(STEP, OKADA)])
    assert found.baselines(step_played)[0].episodes == alone.rows[0].episodes

    document = evaluation.document(found)
    assert document["controller"] == "level"
    step, flat = document["scenes"]
    assert (step["terrain"], flat["terrain"]) == ("step", "flat")
    assert step["seed"] == flat["seed"] == 4
    assert step["conditions"] == Conditions.of(STEP).to_dict()
    assert step["outcomes"] == {"reached": 0, "overturned": 0, "stuck": 2, "timeout": 0}
    assert step["passable"] == passable(2, 0)
    assert flat["passable"] == passable(2, 2)
    okada, random = step["baselines"]
    assert step["baseline"] == okada
    assert (okada["controller"], random["controller"]) == ("okada", "random")
    assert okada["success_rate"] == 1.0
    assert okada["difference"]["t_cost"] is None
    gaps = [b["difference"]["success"] for scene in (step, flat) for b in scene["baselines"]]
    assert gaps[0]["p"] == paired_success(0, 2, 2).p == 0.5
    assert [gap["p_holm"] for gap in gaps] == holm([gap["p"] for gap in gaps])
    no_ends = {"mean": 0.0, "low": None, "high": None, "episodes": 2}
    assert flat["baselines"][0]["difference"]["t_cost"] == no_ends


def test_a_policy_of_the_plan_is_a_reference_with_its_own_settings() -> None:
    finer = EvalConfig(terrain=STEP.terrain, perception={"bins": 20}, eval=TWO)
    plan = Plan((Entry(STEP, LEVEL), Entry(finer, OKADA), Entry(FLAT, LEVEL)))
    assert plan.config_of(OKADA, plan.entries[0]) == finer
    assert plan.config_of(OKADA, plan.entries[2]) == plan.config_of(RANDOM, plan.entries[2]) == FLAT


def test_several_methods_have_rows_of_their_own_and_differences_to_baselines() -> None:
    entries = [Entry(STEP, source, method=source.label()) for source in (OKADA, RANDOM)]
    plan = Plan((*entries, Entry(STEP, LEVEL, method="level", is_baseline=True)))
    okada, random, level = documents(play(plan))
    assert [one["method"] for one in (okada, random, level)] == ["okada", "random", "level"]
    assert okada["baseline"]["difference"]["success"]["won"] == 2
    assert okada["baseline"]["difference"]["success"]["p_holm"] == 1.0
    assert "baseline" not in level


def test_progress_names_who_plays_what_and_counts_to_the_end() -> None:
    opened: list[tuple[str, int]] = []
    reported: list[list[float]] = []

    @contextmanager
    def progress(label: str, episodes: int) -> Iterator[Callable[[float], None]]:
        opened.append((label, episodes))
        done: list[float] = []
        reported.append(done)
        yield done.append

    evaluate([(STEP, LEVEL)], [OKADA], references=[RANDOM, OKADA], progress=progress)
    evaluate([(FLAT, LEVEL)], references=[LEVEL, OKADA], progress=progress)
    assert opened == [
        ("step", 2),
        ("step, random on episodes not crossed yet", 2),
        ("step, okada on episodes not crossed yet", 2),
        ("flat", 2),
    ]
    assert [done for done in reported if done] == [[1, 2]] * 4


def test_an_evaluation_that_is_stopped_before_its_first_episode_says_so() -> None:
    with pytest.raises(InterruptedRunError, match="interrupted: none of 4 episodes is finished"):
        evaluate([(FLAT, LEVEL)], [OKADA], stop=lambda: True)
