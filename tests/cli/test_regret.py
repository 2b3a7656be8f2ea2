"""``inspect reward --regret``, and the line that ``train`` prints at its end."""

import json
import signal
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.errors import FlipperctlError
from flipperctl.training import run as final_regret
from flipperctl.training.run import SEED, FinalRegret
from tests.cli.call import EXACT, call
from tests.short import short_config

TRAIN = {**EXACT, "train.decisions": 120, "train.validation_episodes": 1}


def train(episodes: int, run: str = "run") -> list[str]:
    settings = {**TRAIN, "train.regret_episodes": episodes, "hydra.run.dir": run}
    return ["train", "terrain=step", *(f"{key}={value}" for key, value in settings.items())]


def regret(*arguments: str, cwd: Path) -> list[dict[str, Any]]:
    done = call("inspect", "reward", "--regret", "--json", *arguments, cwd=cwd)
    assert done.code == 0, done.err
    scenes = json.loads(done.out)["scenes"]
    assert isinstance(scenes, list)
    return scenes


def test_returns_are_those_of_an_evaluation_on_the_same_episodes(tmp_path: Path) -> None:
    asked = ["--controller", "okada", "terrain=step,ramp", "--episodes", "5", "eval.seed=5"]
    scenes = regret(*asked, "--against", "level", cwd=tmp_path)
    evaluated = json.loads(call("eval", *asked, "--json", cwd=tmp_path).out)["scenes"]
    assert [scene["terrain"] for scene in scenes] == ["step", "ramp"]
    for one, scene in zip(scenes, evaluated, strict=True):
        assert one["policy"]["return"]["mean"] == pytest.approx(scene["return"]["mean"])
        assert one["conditions"] == scene["conditions"]
        pairs = zip(
            *(found["returns"] for found in (one["policy"], one["references"]["level"])),
            strict=True,
        )
        best = sum(max(pair) for pair in pairs) / 5
        assert one["best_known"]["return"]["mean"] == pytest.approx(best)


def test_a_run_is_judged_by_its_own_reward_unless_another_is_chosen(
    short_run: Path, tmp_path: Path
) -> None:
    asked = ["--checkpoint", str(short_run), "--episodes", "1", "--against", "okada,mpc"]
    small = ["controller.beam=2", "controller.horizon=2"]
    (own,) = regret(*asked, *small, cwd=tmp_path)
    assert (own["rewards"], own["terrain"], own["name"]) == ("own", "step", str(short_run))
    assert set(own["references"]) == {"level", "okada", "mpc"}
    paper, smooth = regret(*asked[:-1], "okada", "rewards=paper,smooth", cwd=tmp_path)
    assert (paper["rewards"], smooth["rewards"]) == ("paper", "smooth")
    assert paper["policy"]["returns"] == own["policy"]["returns"]
    assert smooth["policy"]["returns"] != own["policy"]["returns"]


def test_the_table_has_a_sentence_on_holding_still(tmp_path: Path) -> None:
    words = ["--controller", "okada", "--against", "level", "terrain=flat", "--episodes", "2"]
    done = call("inspect", "reward", "--regret", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "okada on flat: not shown to earn more than holding the flippers still" in done.out
    assert "best of each episode" in done.out


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--regret"], "give either --checkpoint RUN_OR_FILE or --controller NAME"),
        (["--against", "level"], "add --regret"),
        (["--regret", "--compare", "level,okada"], "omit --regret"),
        (["--regret", "--controller", "level", "--against", "okda"], "did you mean 'okada'"),
        (["--regret", "--controller", "level", "--against", "okada,okada"], "each once"),
        (["--regret", "--controller", "level", "~rewards"], "leaves no term"),
        (["--regret", "--controller", "level", "--against", "generalist", "perception.bins=9"],
         "15 bins"),
    ],
)  # fmt: skip
def test_wrong_requests_are_refused(arguments: list[str], expected: str, tmp_path: Path) -> None:
    done = call("inspect", "reward", *arguments, cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    assert expected in done.err


def test_a_training_ends_with_what_the_inspection_says(tmp_path: Path) -> None:
    done = call(*train(5), cwd=tmp_path)
    assert done.code == 0, done.err
    (line,) = [line for line in done.err.splitlines() if line.startswith("Check on 5 new episodes")]
    assert "; flippers held still " in line
    found = json.loads((tmp_path / "run" / "summary.json").read_text())["regret"]
    again = ["--checkpoint", "run", "conditions=trained", f"eval.seed={SEED}", "--episodes", "5"]
    (inspected,) = regret(*again, "--against", "level,okada", cwd=tmp_path)
    assert found["policy"] == inspected["policy"]
    assert found["references"] == inspected["references"]
    assert found["seed"] == inspected["seed"]


def test_it_leaves_the_checkpoints_as_they_are(tmp_path: Path) -> None:
    for words in (train(0, "plain"), train(2)):
        assert call(*words, cwd=tmp_path).code == 0
    assert json.loads((tmp_path / "plain" / "summary.json").read_text())["regret"] is None
    read = [checkpoint.read(tmp_path / run / checkpoint.LAST) for run in ("plain", "run")]
    first, second = (found.document.state for found in read)
    assert first == second
    assert call("train", "--resume", "run", "train.decisions=160", cwd=tmp_path).code == 0


@pytest.mark.parametrize("signals", [1, 2])
def test_ctrl_c_leaves_a_finished_run(
    signals: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = final_regret.measure

    def interrupted(*given: Any) -> Any:
        for _ in range(signals):
            signal.raise_signal(signal.SIGINT)
        return measure(*given)

    monkeypatch.setattr(final_regret, "measure", interrupted)
    done = call(*train(2), cwd=tmp_path)
    assert done.code == 130
    assert "the training is finished and saved" in done.err.splitlines()[-1]
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["finished"], summary["regret"]) == (True, None)
    again = call("train", "--resume", "run", cwd=tmp_path)
    assert again.code == 0
    assert "nothing left to do" in again.err
    assert list((tmp_path / "run").rglob("*.part")) == []


def test_a_run_that_died_while_it_was_compared_is_compared_when_it_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*given: Any) -> None:
        raise MemoryError

    with monkeypatch.context() as context:
        context.setattr(final_regret, "measure", die)
        assert call(*train(2), cwd=tmp_path).code == 1
    summary = tmp_path / "run" / "summary.json"
    assert not summary.exists()
    done = call("train", "--resume", "run", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "Check on 2 new episodes" in done.err
    assert json.loads(summary.read_text())["regret"]["episodes"] == 2


def test_a_failure_is_told_and_the_run_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: Any) -> None:
        raise FlipperctlError("the rule fell over")

    monkeypatch.setattr(final_regret, "measure", fail)
    done = call(*train(2), cwd=tmp_path)
    assert done.code == 0
    assert "the return of the best policy is not measured: the rule fell over" in done.err


@pytest.mark.parametrize(
    ("teacher", "names"),
    [
        ({"name": "okada"}, ["level", "okada"]),
        ({"name": "okada", "rear_gain": 0.9}, ["level", "okada", "teacher"]),
        ({"name": "mpc"}, ["level", "okada"]),  # it searches, which takes too long
    ],
)
def test_a_teacher_that_is_a_rule_is_compared(
    teacher: dict[str, Any], names: list[str], tmp_path: Path
) -> None:
    config = short_config(**{"teacher.controller": teacher})
    found = FinalRegret(config, tmp_path, lambda: False, print)._references()
    assert list(found) == names
