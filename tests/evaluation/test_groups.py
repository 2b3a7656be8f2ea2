"""Results by what was drawn, from episodes made by hand."""

import pytest

from flipperctl.config import EvalConfig
from flipperctl.errors import RequestError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.groups import grouped, parse
from flipperctl.evaluation.results import EvaluationResult, Group, SceneResult
from flipperctl.evaluation.scenes import compare, evaluate
from flipperctl.evaluation.statistics import summarise
from flipperctl.policies.source import PolicySource
from flipperctl.terminal.evaluation import group_tables, table
from tests.evaluation.samples import sample

STEPS = (3, 3, 3, 3, 3, 12, 12)


def result(numbers: list[dict[str, float]]) -> EvaluationResult:
    """Return episodes that drew these numbers; the baseline's θ̂_R is 1 rad smaller."""
    ours = [sample(i, "reached", 3.0 + i, drawn=drawn) for i, drawn in enumerate(numbers)]
    theirs = [sample(i, "reached", 2.5 + i, drawn=drawn) for i, drawn in enumerate(numbers)]
    other = compare("stair", ours, "level", theirs)
    conditions = Conditions("nominal", {}, {})
    scene = SceneResult("mine", summarise("stair", ours), 0, conditions, (other,), tuple(ours))
    return EvaluationResult((scene,))


def groups(numbers: list[dict[str, float]], *names: str) -> tuple[Group, ...]:
    (scene,) = grouped(result(numbers), [names]).scenes
    return scene.by["+".join(names)]


@pytest.mark.usefixtures("core_measures")
def test_each_value_has_its_episodes_and_its_differences() -> None:
    short, long = groups([{"steps": steps} for steps in STEPS], "steps")
    assert (short.ranges, long.ranges) == ({"steps": (3, 3)}, {"steps": (12, 12)})
    assert (short.summary.episodes, long.summary.episodes) == (5, 2)
    assert long.summary.pitch_variation is not None
    assert long.summary.pitch_variation.mean == pytest.approx(8.5)  # of 8 and 9
    (level,) = short.baselines
    assert level.controller == "level"
    assert level.difference.pitch_variation is not None
    found = level.difference.pitch_variation
    assert (found.mean, found.low, found.high, found.episodes) == (0.5, 0.5, 0.5, 5)


@pytest.mark.usefixtures("core_measures")
def test_many_values_are_split_at_their_quartiles() -> None:
    found = groups([{"slope": 20.0 + i} for i in range(12)], "slope")
    ranges = [group.ranges["slope"] for group in found]
    assert ranges == [(20, 22), (23, 25), (26, 28), (29, 31)]
    assert [group.summary.episodes for group in found] == [3, 3, 3, 3]


@pytest.mark.usefixtures("core_measures")
def test_combinations_and_samples_group_too_and_other_ground_is_left_out() -> None:
    numbers = [{"steps": 3, "up": i % 2} for i in range(6)] + [{"height": 0.2}]
    found = groups(numbers, "steps", "up")
    assert [g.ranges for g in found] == [
        {"steps": (3, 3), "up": (0, 0)},
        {"steps": (3, 3), "up": (1, 1)},
    ]
    assert [g.summary.episodes for g in found] == [3, 3]
    (every,) = groups(numbers, "start_shift")  # a sampled value, the same in all
    assert every.summary.episodes == 7


@pytest.mark.usefixtures("core_measures")
def test_the_document_and_the_table_have_a_row_for_each_group() -> None:
    found = grouped(result([{"steps": steps} for steps in STEPS]), [("steps",)])
    short, long = found.to_dict()["scenes"][0]["by"]["steps"]
    assert short["drawn"] == {"steps": {"low": 3, "high": 3}}
    assert long["episodes"] == 2
    assert long["baseline"]["difference"]["pitch_variation"]["mean"] == 0.5
    (shown,) = group_tables(found)
    assert shown.title == "stair by steps"
    assert shown.headings[:2] == ["steps", "episodes"]
    assert "by" not in result([{"steps": 3}]).to_dict()["scenes"][0]


def test_names_are_checked_before_an_episode_is_played() -> None:
    scenes = [EvalConfig(terrain="flat"), EvalConfig(terrain="building_stair")]
    assert parse("steps, slope+up,start_shift", "--by", scenes) == [
        ("steps",),
        ("slope", "up"),
        ("start_shift",),
    ]
    assert parse(None, "--by", scenes) == []
    varied = EvalConfig(terrain="flat", randomise={"friction": (0.6, 1.2)})
    assert parse("friction", "--by", [varied]) == [("friction",)]
    with pytest.raises(RequestError, match=r"--by: no scene draws 'step'; did you mean 'steps'\?"):
        parse("step", "--by", scenes)
    for wrong in ("", "steps,", "steps+steps"):
        with pytest.raises(RequestError, match="names as in"):
            parse(wrong, "--by", scenes)
    for twice in ("steps,steps", "steps+up, up+steps"):
        with pytest.raises(RequestError, match="is given twice; once is allowed"):
            parse(twice, "--by", scenes)


def test_a_bound_stands_beside_each_episode_and_below_what_was_measured() -> None:
    level = PolicySource.of_plugin("level", "here")
    okada = PolicySource.of_plugin("okada", "here")
    terrain = {"name": "ramp", "slope_low": 34, "direction": "up", "back": False}
    config = EvalConfig(terrain=terrain, eval={"episodes": 2, "static_bound": True})
    found = evaluate([(config, level)], baselines=[okada])
    (scene,) = found.scenes
    (other,) = scene.baselines
    for mine, theirs in zip(scene.episodes, other.episodes, strict=True):
        assert mine.static_bound == theirs.static_bound == mine.row()["static_bound"]
        assert mine.static_bound is not None
        assert (
            0.05
            < mine.static_bound
            <= min(mine.pitch_variation_100hz, theirs.pitch_variation_100hz)
        )
    assert scene.to_dict()["static_bound"]["mean"] > 0.05
    assert "static bound [rad]" in table(found, "level").headings
