"""Results by what was drawn, from episodes made by hand."""

from typing import Any

import pytest

from flipperctl.config import EvalConfig
from flipperctl.errors import RequestError
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.views import evaluation, strata
from flipperctl.evaluation.views.strata import parse
from tests.evaluation.samples import result as made
from tests.evaluation.samples import sample

STEPS = (3, 3, 3, 3, 3, 12, 12)


def result(numbers: list[dict[str, float]]) -> Result:
    """Return episodes that drew these numbers; the baseline's θ̂_R is 0.5 rad smaller."""

    def rows(first: float) -> list[dict[str, Any]]:
        drawn = [{f"drawn_{name}": value for name, value in one.items()} for one in numbers]
        return [sample(i, "reached", first + i, **one) for i, one in enumerate(drawn)]

    return made(rows(3.0), {"level": rows(2.5)}, terrain="stair")


def groups(numbers: list[dict[str, float]], *names: str) -> list[dict[str, Any]]:
    (scene,) = evaluation.document(result(numbers), [names])["scenes"]
    found: list[dict[str, Any]] = scene["by"]["+".join(names)]
    return found


def ranges(group: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {name: (ends["low"], ends["high"]) for name, ends in group["drawn"].items()}


@pytest.mark.usefixtures("core_measures")
def test_each_value_has_its_episodes_and_its_differences() -> None:
    short, long = groups([{"steps": steps} for steps in STEPS], "steps")
    assert (ranges(short), ranges(long)) == ({"steps": (3, 3)}, {"steps": (12, 12)})
    assert (short["episodes"], long["episodes"]) == (5, 2)
    assert long["pitch_variation"]["mean"] == pytest.approx(8.5)  # of 8 and 9
    level = short["baseline"]
    assert level["controller"] == "level"
    gap = {"mean": 0.5, "low": 0.5, "high": 0.5, "episodes": 5}
    assert level["difference"]["pitch_variation"] == gap


@pytest.mark.usefixtures("core_measures")
def test_many_values_are_split_at_their_quartiles() -> None:
    found = groups([{"slope": 20.0 + i} for i in range(12)], "slope")
    drawn = [ranges(group)["slope"] for group in found]
    assert drawn == [(20, 22), (23, 25), (26, 28), (29, 31)]
    assert [group["episodes"] for group in found] == [3, 3, 3, 3]


@pytest.mark.usefixtures("core_measures")
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


@pytest.mark.usefixtures("core_measures")
def test_the_document_and_the_table_have_a_row_for_each_group() -> None:
    found = evaluation.document(result([{"steps": steps} for steps in STEPS]), [("steps",)])
    (scene,) = found["scenes"]
    short, long = scene["by"]["steps"]
    assert short["drawn"] == {"steps": {"low": 3, "high": 3}}
    assert long["episodes"] == 2
    assert long["baseline"]["difference"]["pitch_variation"]["mean"] == 0.5
    (shown,) = strata.tables("stair", scene)
    assert shown.title == "mine on stair by steps"
    assert [text[:2] for text in shown.texts()] == [["3", "5"], ["12", "2"]]
    assert shown.texts()[0][-1] == "+1.00 [+1.00, +1.00]"  # at 100 Hz
    assert "by" not in evaluation.document(result([{"steps": 3}]))["scenes"][0]


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
