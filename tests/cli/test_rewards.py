"""``inspect reward`` of one and of several policies, and what ``train`` says at its end."""

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from flipperctl.errors import FlipperctlError
from flipperctl.evaluation import regret as final_regret
from flipperctl.evaluation.regret import SEED, regret_scene
from tests.cli.call import EXACT, call
from tests.short import short_config

TRAIN = {**EXACT, "train.decisions": 120, "train.validation_episodes": 1}


def train(episodes: int, run: str = "run") -> list[str]:
    settings = {**TRAIN, "train.regret_episodes": episodes, "hydra.run.dir": run}
    return ["train", "terrain=step", *(f"{key}={value}" for key, value in settings.items())]


def regret(*arguments: str, cwd: Path) -> list[dict[str, Any]]:
    done = call("inspect", "reward", *arguments, "--regret", "--json", cwd=cwd)
    assert done.code == 0, done.err
    scenes = json.loads(done.out)["scenes"]
    assert isinstance(scenes, list)
    return scenes


def test_returns_are_those_of_an_evaluation_on_the_same_episodes(tmp_path: Path) -> None:
    asked = ["terrain=step,ramp", "--episodes", "2", "eval.seed=5"]
    scenes = regret("okada", "level", *asked, cwd=tmp_path)
    evaluated = json.loads(call("eval", "okada", *asked, "--json", cwd=tmp_path).out)["scenes"]
    assert [scene["terrain"] for scene in scenes] == ["step", "ramp"]
    for one, scene in zip(scenes, evaluated, strict=True):
        assert one["policy"]["return"]["mean"] == pytest.approx(scene["return"]["mean"])
        assert one["conditions"] == scene["conditions"]
        pairs = zip(
            *(found["returns"] for found in (one["policy"], one["references"]["level"])),
            strict=True,
        )
        best = sum(max(pair) for pair in pairs) / 2
        assert one["best_known"]["return"]["mean"] == pytest.approx(best)


def test_a_run_is_judged_by_its_own_reward_unless_another_is_chosen(
    short_run: Path, tmp_path: Path
) -> None:
    asked = [str(short_run), "okada", "--episodes", "1"]
    (own,) = regret(*asked, cwd=tmp_path)
    assert (own["rewards"], own["terrain"], own["name"]) == ("own", "step", str(short_run))
    assert set(own["references"]) == {"level", "okada"}
    paper, smooth = regret(*asked, "rewards=paper,smooth", cwd=tmp_path)
    assert (paper["rewards"], smooth["rewards"]) == ("paper", "smooth")
    assert paper["policy"]["returns"] == own["policy"]["returns"]
    assert smooth["policy"]["returns"] != own["policy"]["returns"]


@pytest.mark.parametrize("words", [[], ["level"], ["level", "--regret"]])
def test_a_run_has_the_name_that_the_table_of_eval_has(
    words: list[str], short_run: Path, tmp_path: Path
) -> None:
    done = call("inspect", "reward", str(short_run), *words, "--episodes", "1", cwd=tmp_path)
    assert done.code == 0, done.err
    assert short_run.name in done.out
    assert str(short_run.parent) not in done.out


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A run that was compared at its end, and what the command printed; copy it to change it."""
    folder = tmp_path_factory.mktemp("compared")
    done = call(*train(2), cwd=folder)
    assert done.code == 0, done.err
    return folder / "run", done.err


def test_a_training_ends_with_what_the_inspection_says(
    compared: tuple[Path, str], tmp_path: Path
) -> None:
    run, err = compared
    (line,) = [line for line in err.splitlines() if line.startswith("Check on 2 new episodes")]
    assert "; flippers held still " in line
    found = json.loads((run / "summary.json").read_text())["regret"]
    again = ["conditions=trained", f"eval.seed={SEED}", "--episodes", "2"]
    (inspected,) = regret(str(run), "level,geometric", *again, cwd=tmp_path)
    assert found["policy"] == inspected["policy"]
    assert found["references"] == inspected["references"]
    assert found["seed"] == inspected["seed"]


@pytest.mark.parametrize(
    "trouble", ["Ctrl-C", pytest.param("Ctrl-C twice", marks=pytest.mark.long), "death", "failure"]
)
def test_whatever_happens_meanwhile_the_training_is_finished_and_goes_on(
    trouble: str, compared: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that died while it was compared is compared when it is resumed."""
    run = Path(shutil.copytree(compared[0], tmp_path / "run"))
    summary = run / "summary.json"
    summary.unlink()
    measure = final_regret.measure

    def troubled(*given: Any) -> Any:
        if trouble == "death":
            raise MemoryError
        if trouble == "failure":
            raise FlipperctlError("the rule fell over")
        for _ in trouble.split():
            signal.raise_signal(signal.SIGINT)
        return measure(*given)

    with monkeypatch.context() as context:
        context.setattr(final_regret, "measure", troubled)
        done = call("train", "--resume", "run", cwd=tmp_path)
    code, text = {
        "death": (1, "there is not enough memory"),
        "failure": (0, "the return of the best policy is not measured: the rule fell over"),
    }.get(trouble, (130, "the training is finished and saved"))
    assert (done.code, text in done.err) == (code, True), done.err
    assert summary.exists() == (trouble != "death")
    if trouble != "death":
        found = json.loads(summary.read_text())
        assert (found["finished"], found["regret"]) == (True, None)
    again = call("train", "--resume", "run", cwd=tmp_path)
    assert again.code == 0
    told = "Check on 2 new episodes" if trouble == "death" else "nothing left to do"
    assert told in again.err
    assert list(run.rglob("*.part")) == []


@pytest.mark.parametrize(
    ("teacher", "names"),
    [
        ({"name": "geometric"}, ["level", "geometric"]),
        ({"name": "geometric", "turn": 0.02}, ["level", "geometric", "teacher"]),
        ({"name": "mpc"}, ["level", "geometric"]),  # it searches, which takes too long
    ],
)
def test_a_teacher_that_is_a_rule_is_compared(
    teacher: dict[str, Any], names: list[str], tmp_path: Path
) -> None:
    config = short_config(**{"teacher.controller": teacher})
    found = regret_scene(config, tmp_path).references
    assert list(found) == names


@pytest.mark.long
def test_the_presets_pay_the_smooth_way_and_a_price_of_turning_does_not(tmp_path: Path) -> None:
    # Over a ramp mpc swings less than the rule and turns the flippers for it.
    small = ["controller.beam=4", "controller.horizon=6"]
    ramp = ["terrain=ramp", "terrain.slope=[20,25]"]
    sets = ["rewards=tuned,smooth", "rewards.travel.weight=0.02,0.8"]
    options = ["okada", "mpc", "--episodes", "5", "--json"]
    done = call("inspect", "reward", *options, *ramp, *sets, *small, cwd=tmp_path)
    (scene,) = json.loads(done.out)["scenes"]
    assert scene["by_pitch_variation_100hz"] == ["mpc", "okada"]
    assert (scene["episodes"], scene["common"]) == (5, 5)
    assert {one["rewards"]: one["verdict"] for one in scene["rankings"]} == {
        "tuned rewards.travel.weight=0.02": "agrees",
        "smooth rewards.travel.weight=0.02": "agrees",
        "tuned rewards.travel.weight=0.8": "contradicts",
        "smooth rewards.travel.weight=0.8": "contradicts",
    }
    (found,) = next(
        r["contradictions"]
        for r in scene["rankings"]
        if "smooth" in r["rewards"] and r["contradictions"]
    )
    assert (found["paid"], found["calm"]) == ("okada", "mpc")
    assert next(iter(found["terms"])) == "travel"
