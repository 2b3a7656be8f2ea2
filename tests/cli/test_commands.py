"""The commands end to end, as a user types them."""

import json
import re
import signal
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.env.metrics import RESERVED, measures
from flipperctl.text.files import read_csv
from flipperctl.training.trainer import Trainer
from tests.cli.call import EXACT, call

QUICK = [f"{key}={value}" for key, value in EXACT.items()]


def test_train_stops_by_ctrl_c_and_resumes_to_every_promised_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    train = Trainer._train_episode

    def pressed(self: Trainer, collector: object) -> None:
        train(self, collector)
        if self.progress.decision >= 60:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Trainer, "_train_episode", pressed)
    done = call("train", "terrain=step", "train.validate_every=30", *QUICK, cwd=tmp_path)
    (run,) = (tmp_path / "runs" / "step").iterdir()
    resume = ("train", "--resume", str(run.relative_to(tmp_path)))
    assert (done.code, " ".join(("flipperctl", *resume)) in done.err) == (130, True)
    stopped = checkpoint.read(run / checkpoint.LAST).document.state
    assert stopped is not None
    assert 60 <= stopped.decision < 200
    monkeypatch.undo()
    for word in ("best_by=success", "validation_seed=5", "validation_episodes=3", "record=true"):
        done = call(*resume, f"train.{word}", cwd=tmp_path)
        assert done.code == 2
        assert f"train.{word}: the run goes on with train.{word.partition('=')[0]}=" in done.err

    done = call(*resume, "train.decisions=200", "train.best_by=return", cwd=tmp_path)
    assert done.code == 0, done.err
    assert f"flipperctl eval {run.relative_to(tmp_path)}" in done.err
    found = {str(p.relative_to(run)) for p in run.rglob("*") if p.is_file()}
    promised = {"config.yaml", "metrics.csv", "summary.json", checkpoint.BEST, checkpoint.LAST}
    assert set(map(str, promised)) <= found
    assert any("tfevents" in name for name in found)
    rows = read_csv(run / "metrics.csv")
    assert {row["kind"] for row in rows} == {"episode", "validation"}
    decisions = [int(row["decision"]) for row in rows]
    assert decisions == sorted(decisions)
    assert decisions[-1] == 200
    assert "nothing left to do" in call(*resume, cwd=tmp_path).err
    done = call("inspect", "run", str(run), "--output", "curves.svg", "--json", cwd=tmp_path)
    document = json.loads(done.out)
    assert document["summary"]["finished"] is True
    assert document["validations"][-1]["decision"] == 200
    assert (tmp_path / "curves.svg").read_text().lstrip().startswith("<?xml")
    less = call(*resume, "train.decisions=1", cwd=tmp_path)
    assert less.code == 0
    assert f"{resume[2]} has trained 200 decisions, and train.decisions is 1;" in less.err


def test_eval_json_is_one_document_on_stdout(short_run: Path, tmp_path: Path) -> None:
    arguments = ["--episodes", "2", "--json", "--output", "out", "terrain=step,paper_step"]
    done = call("eval", "--checkpoint", str(short_run), *arguments, cwd=tmp_path)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert [scene["terrain"] for scene in document["scenes"]] == ["step", "paper_step"]
    assert set(document["scenes"][0]["outcomes"]) == {"reached", "overturned", "stuck", "timeout"}
    assert set(document["scenes"][0]) <= RESERVED | set(measures())  # no plugin may take a key
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == document
    assert len((tmp_path / "out" / "episodes.csv").read_text().splitlines()) == 1 + 4
    assert (tmp_path / "out" / "paper_step.png").read_bytes().startswith(b"\x89PNG")


def test_repeats_that_are_one_drive_are_named(tmp_path: Path) -> None:
    drives = ("eval", "level", "terrain=flat", "--episodes", "2")
    said = "flat: all 2 episodes are identical"
    assert said in call(*drives, "episode.start_noise=0", cwd=tmp_path).err
    assert "identical" not in call(*drives, cwd=tmp_path).err


def test_export_takes_another_robot_and_says_so(short_run: Path, tmp_path: Path) -> None:
    export = ("export", "onnx", str(short_run), "--output", "p.onnx")
    done = call(*export, "robot.flipper_speed=0.5", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "the chosen action agrees on 100 %" in done.out
    assert done.out.splitlines()[-1] == (
        "for another robot than that of the training: robot.flipper_speed 0.5 rad/s (training "
        "0.436332), decision period 0.523599 s (training 0.6)"
    )
    again = call("export", "onnx", "p.onnx", cwd=tmp_path)
    assert "p.onnx: an exported file holds no training; give its run or checkpoint" in again.err
    (tmp_path / "p.onnx").unlink()
    for override, error in {
        "terrain=stair": "terrain: export takes settings of the robot alone",
        "sim.friction=0.7": "sim.friction: export takes settings of the robot alone",
        "robot=x": "robot: there is no robot 'x'; known: absolem, nubot; a file of your own",
        "robot=../w/x.urdf": "robot: there is no robot '../w/x.urdf'; known: absolem",
    }.items():
        done = call(*export, override, cwd=tmp_path)
        assert (done.code, done.out) == (2, "")
        assert f"error: {error}" in done.err
    assert not (tmp_path / "p.onnx").exists()


def test_inspect_shows_plugins_terrains_checkpoints_and_configurations(
    short_run: Path, tmp_path: Path
) -> None:
    done = call("inspect", "plugins", "stair", "--json", cwd=tmp_path)
    (stair,) = (p for p in json.loads(done.out) if p["kind"] == "terrain")
    assert re.search(r"stairs\.py:\d+$", stair["source"])
    rise = next(field for field in stair["fields"] if field["name"] == "rise")
    assert (rise["default"], rise["bounds"], rise["unit"]) == (0.2, "> 0, ≤ 0.5", "m")

    done = call("inspect", "terrain", "stair", "--output", "s.png", "--json", cwd=tmp_path)
    draw = json.loads(done.out)["draws"][0]
    assert draw["largest_face"] == pytest.approx(0.2)
    assert abs(draw["climb"]) in [pytest.approx(0.2 * steps) for steps in (3, 4, 5)]
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
    drawn = call("inspect", "terrain", "stair", cwd=tmp_path).out
    equal = call("inspect", "terrain", "paper_step", cwd=tmp_path).out  # the same for each seed
    assert len(drawn.splitlines()) == len(equal.splitlines()) + 2
    assert "\n1, 2  " in drawn  # whose ground is equal

    for name in (checkpoint.BEST, checkpoint.LAST):
        done = call("inspect", "checkpoint", str(short_run / name), "--json", cwd=tmp_path)
        assert json.loads(done.out)["config"]["terrain"]["name"] == "step"
    again = ("rewards.again=pitch", "rewards.again.weight=0.5")
    done = call("inspect", "config", "rewards=paper", "~rewards.pitch", *again, cwd=tmp_path)
    assert "pitch:" not in done.out
    assert "weight: 0.5" in done.out


def test_one_document_with_machine_settings_and_raw_numbers(tmp_path: Path) -> None:
    words = ("bench", "--small", "--json", "--output", "speed", "terrain=step")
    done = call(*words, "train.mode=exact", cwd=tmp_path)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert json.loads((tmp_path / "speed" / "bench.json").read_text()) == document
    assert {"date", "versions", "processor", "cores", "load_average"} <= set(document["machine"])
    found = [q for one in document["measures"].values() for q in one["quantities"].items()]
    assert {name: q["unit"] for name, q in found if "demo" not in name} == {
        "training": "1/s",
        "evaluation.mujoco": "-",
        "evaluation.planar": "-",
        "decision.median": "µs",
        "decision.p99": "µs",
    }
    assert all(len(q["values"]) == 2 and min(q["values"]) > 0 for _, q in found)
