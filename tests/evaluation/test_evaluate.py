"""A policy on scenes, beside a baseline and references that try what it fails.

The hash of the conditions is equal where evaluations are comparable, and only there.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from flipperctl.config import EvalConfig, with_overrides
from flipperctl.errors import InterruptedRunError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.evaluate import evaluate as play
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.statistics import holm, paired_success, proportion
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.views import evaluation

LEVEL, OKADA, RANDOM = (load_policy(name, "here") for name in ("level", "okada", "random"))
TWO = {"episodes": 2, "seed": 4}
STEP = EvalConfig(terrain={"name": "step", "height": 0.4}, eval=TWO)
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


def of(**overrides: object) -> Conditions:
    base = EvalConfig(terrain="step")
    return Conditions.of(with_overrides(base, overrides))


def test_the_hash_is_that_of_the_canonical_json_of_what_stands_beside_it() -> None:
    found = of().to_dict()
    assert found.pop("name") == "nominal"
    short = found.pop("hash")
    text = json.dumps(found, sort_keys=True, separators=(",", ":"))
    assert short == hashlib.sha256(text.encode()).hexdigest()[:8]
    assert set(found) == {"terrain", "robot", "sim", "perception", "episode", "randomise"}


@pytest.mark.parametrize(
    ("change", "changes"),
    [
        ({"terrain.height": 0.3}, True),
        ({"robot.chassis_mass": 36}, True),
        ({"sim.friction": 0.9}, True),
        ({"perception.noise": 0.01}, True),
        ({"episode.start_noise": 0.1}, True),
        ({"randomise.perception.delay": [0, 0.1]}, True),
        ({"perception.bins": 21, "perception.bin_width": 0.1}, False),
        ({"rewards.pitch.weight": 2}, False),
        ({"eval.seed": 3, "eval.episodes": 5}, False),
        ({"conditions": "trained"}, False),
        ({"robot.chassis_mass": 35}, False),
    ],
)
def test_what_changes_draws_or_physics_changes_the_hash(
    change: dict[str, object], changes: bool
) -> None:
    assert (of(**change).hash != of().hash) == changes


def test_the_hash_covers_the_content_of_recorded_ground(tmp_path: Path) -> None:
    file = tmp_path / "curb.csv"
    settings = {
        "terrain": {"name": "mirror", "terrain": {"name": "profile_file", "path": str(file)}}
    }
    missing = of(**settings)
    assert missing.to_dict()["files"] == [None]
    found = []
    for text in ("x,z\n0,0\n1,0.1\n", "x,z\n0,0\n1,0.2\n"):
        file.write_text(text)
        found.append(of(**settings))
        assert found[-1].to_dict()["files"] == [hashlib.sha256(text.encode()).hexdigest()]
    assert len({missing.hash, *(conditions.hash for conditions in found)}) == 3


def test_the_line_says_what_is_drawn_and_what_differs_from_the_defaults() -> None:
    assert of().line() == ""
    changed = of(
        **{
            "randomise.perception.bias": [-0.01, 0.01],
            "randomise.perception.dropout": [0, 0.2],
            "randomise.perception.pitch_bias": [0, 0.1],
            "perception.noise": 0.01,
            "perception.occlusion": True,
            "sim.friction": 0.8,
            "robot.chassis_mass": 60,
            "episode.start_angle_noise": 0.1,
        }
    )
    assert changed.line() == (
        "randomised perception.bias -0.01 to 0.01 m, perception.dropout 0 to 0.2, "
        "perception.pitch_bias 0 to 0.1 rad; "
        "start start_angle_noise 0.1 rad; sensing noise 0.01 m, occlusion on; "
        "physics friction 0.8; robot chassis_mass 60 kg"
    )
    assert of(
        **{f"randomise.sim.{n}": [9, 10] for n in ("gravity", "friction")},
        **{f"randomise.robot.{n}": [30, 40] for n in ("flipper_torque", "chassis_mass")},
    ).line() == (
        "randomised sim.gravity 9 to 10 m/s², sim.friction 9 to 10, "
        "robot.flipper_torque 30 to 40 N m and 1 more"
    )
    axes = ("sim.friction", "episode.start_noise", "terrain.height")
    assert changed.line(axes).endswith(
        "sensing noise 0.01 m, occlusion on; physics friction varied; robot chassis_mass 60 kg"
    )
