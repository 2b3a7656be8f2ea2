"""The commands end to end, as a user types them."""

import csv
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.training.listeners import read_rows
from tests.cli.call import RUN, call

QUICK = [f"{key}={value}" for key, value in RUN.items()]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run made by the command line, in its default place."""
    folder = tmp_path_factory.mktemp("work")
    done = call("train", "terrain=step", "seed=7", *QUICK, cwd=folder)
    assert done.code == 0, done.err
    (made,) = (folder / "runs" / "step").iterdir()
    assert f"flipperctl eval --checkpoint {made.relative_to(folder)}" in done.err
    return made


def test_train_leaves_every_promised_file(run: Path) -> None:
    found = {str(p.relative_to(run)) for p in run.rglob("*") if p.is_file()}
    assert {
        "config.yaml",
        "metrics.csv",
        "summary.json",
        "checkpoints/best.safetensors",
        "checkpoints/last.safetensors",
    } <= found
    assert any("tfevents" in name for name in found)
    kinds = {row["kind"] for row in read_rows(run / "metrics.csv")}
    assert kinds == {"episode", "validation"}


def test_multirun_makes_a_run_for_each_combination(tmp_path: Path) -> None:
    done = call("train", "-m", "terrain=flat,step", "seed=1", *QUICK, cwd=tmp_path)
    assert done.code == 0, done.err
    (sweep,) = (tmp_path / "runs" / "multirun").iterdir()
    names = {p.name for p in sweep.iterdir() if p.is_dir()}
    assert names == {"0_terrain=flat", "1_terrain=step"}
    assert all((sweep / name / checkpoint.BEST).is_file() for name in names)
    table = done.err[done.err.index("2 runs") :]
    assert all(word in table for word in ("terrain", "flat", "step", *names, "sweep.csv"))
    with (sweep / "sweep.csv").open(newline="") as file:
        flat, step = csv.DictReader(file)
    assert (flat["job"], flat["terrain"], step["terrain"]) == ("0", "flat", "step")
    assert (step["decisions"], step["state"]) == ("300", "finished")
    best = json.loads((sweep / "1_terrain=step" / "summary.json").read_text())["best"]
    assert (float(step["success_rate"]), int(step["best_decision"])) == (0.0, best["decision"])
    for name in ("pitch_variation_100hz", "pitch_variation", "t_cost"):
        assert step[name] == ""  # of those that reached the finish


def test_cfg_prints_the_composed_configuration_and_trains_nothing(tmp_path: Path) -> None:
    done = call("train", "terrain=step", "agent.gamma=0.5", "--cfg", "job", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "gamma: 0.5" in done.out
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_saves_and_resume_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "flipperctl", "train", "terrain=step", "hydra.run.dir=r"]
    budget = ["train.decisions=100000", "agent.learning_starts=50", "train.workers=2"]
    budget += ["train.validation_episodes=2", "train.regret_episodes=0"]
    process = subprocess.Popen([*command, *budget], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    metrics = tmp_path / "r" / "metrics.csv"
    while not metrics.is_file() or metrics.read_text().count("\n") < 3:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "flipperctl train --resume r" in err
    stopped = checkpoint.read(tmp_path / "r" / checkpoint.LAST).document.state.decision
    assert 0 < stopped < 100_000

    more = f"train.decisions={stopped + 50}"
    done = call("train", "--resume", "r", more, "train.best_by=success", cwd=tmp_path)
    assert done.code == 0, done.err
    state = checkpoint.read(tmp_path / "r" / checkpoint.LAST).document.state
    assert state is not None
    assert state.decision == stopped + 50
    decisions = [int(row["decision"]) for row in read_rows(metrics)]
    assert decisions == sorted(decisions)

    for word in (
        "best_by=return",
        "validation_seed=5",
        "validation_episodes=3",
        "record=true",
        "mode=exact",
    ):
        done = call("train", "--resume", "r", f"train.{word}", cwd=tmp_path)
        assert done.code == 2
        assert f"train.{word}: the run goes on with train.{word.partition('=')[0]}=" in done.err

    again = call("train", "--resume", "r", cwd=tmp_path)
    assert again.code == 0
    assert "nothing left to do" in again.err
    less = call("train", "--resume", "r", "train.decisions=1", cwd=tmp_path)
    assert less.code == 0
    assert f"r has trained {stopped + 50} decisions, and train.decisions is 1;" in less.err


def test_eval_json_is_one_document_on_stdout(run: Path, tmp_path: Path) -> None:
    arguments = ["--episodes", "2", "--json", "--output", "out", "terrain=step,paper_step"]
    done = call("eval", "--checkpoint", str(run), *arguments, cwd=tmp_path)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert [scene["terrain"] for scene in document["scenes"]] == ["step", "paper_step"]
    scene = document["scenes"][0]
    assert scene["episodes"] == 2
    assert set(scene["outcomes"]) == {"reached", "overturned", "stuck", "timeout"}
    assert 0 <= scene["success_rate"] <= 1
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == document
    assert len((tmp_path / "out" / "episodes.csv").read_text().splitlines()) == 1 + 4
    assert (tmp_path / "out" / "paper_step.png").read_bytes().startswith(b"\x89PNG")


def test_eval_compares_with_a_baseline_on_equal_draws(tmp_path: Path) -> None:
    arguments = ["terrain=flat", "--episodes", "5", "--baseline", "level", "--json"]
    done = call("eval", "--controller", "okada", *arguments, cwd=tmp_path)
    difference = json.loads(done.out)["scenes"][0]["baseline"]["difference"]
    assert difference["t_cost"] == {"mean": 0.0, "low": 0.0, "high": 0.0, "episodes": 5}
    success = difference["success"]
    assert (success["won"], success["lost"], success["p"]) == (0, 0, 1.0)
    assert (success["low"], success["high"]) == pytest.approx((-0.4345, 0.4345), abs=1e-4)
    table = call("eval", "--controller", "okada", *arguments[:-1], cwd=tmp_path)
    assert "\nagainst level, same episodes: pitch variation +0.00 rad [" in table.out
    assert "pitch variation [rad]  time [s]\n" in table.out  # units are no markup


def test_export_prints_what_it_compared(run: Path, tmp_path: Path) -> None:
    done = call("export", "onnx", "--checkpoint", str(run), "--output", "p.onnx", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "the chosen action agrees on 100.00%" in done.out
    assert (tmp_path / "p.onnx").stat().st_size > 10_000


def test_repeats_that_are_one_drive_are_named(tmp_path: Path) -> None:
    still = ("terrain=flat", "episode.start_noise=0", "--controller", "level", "--episodes")
    said = "flat: all 2 episodes are identical"
    assert said in call("eval", *still, "2", cwd=tmp_path).err
    assert "drive" not in call("eval", *still, "1", cwd=tmp_path).err
    noise = [word for word in still if not word.startswith("episode.")]
    assert "drive" not in call("eval", *noise, "2", cwd=tmp_path).err


def test_an_exported_file_is_not_exported_again(tmp_path: Path) -> None:
    (tmp_path / "p.onnx").write_bytes(b"anything")
    done = call("export", "onnx", "--checkpoint", "p.onnx", cwd=tmp_path)
    assert (done.code, done.err) == (
        2,
        "error: p.onnx is already exported; give its run or checkpoint\n",
    )


def test_export_takes_another_robot_and_says_so(run: Path, tmp_path: Path) -> None:
    export = ("export", "pt2", "--checkpoint", str(run), "--output", "p.pt2")
    done = call(*export, "robot.flipper_speed=0.5", cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.out.splitlines()[-1] == (
        "for another robot than that of the training: robot.flipper_speed 0.5 rad/s (training "
        "0.436332), decision period 0.523599 s (training 0.6)"
    )
    (tmp_path / "p.pt2").unlink()
    for override, error in {
        "terrain=stair": "terrain: export takes settings of the robot alone",
        "sim.friction=0.7": "sim.friction: export takes settings of the robot alone",
        "robot=x": "robot: there is no robot 'x'; known: absolem, nubot",
    }.items():
        done = call(*export, override, cwd=tmp_path)
        assert (done.code, done.out) == (2, "")
        assert f"error: {error}" in done.err
    assert not (tmp_path / "p.pt2").exists()


def test_inspect_plugins_shows_origin_unit_bounds_and_default(tmp_path: Path) -> None:
    done = call("inspect", "plugins", "--json", cwd=tmp_path)
    plugins = {(p["kind"], p["name"]): p for p in json.loads(done.out)}
    stair = plugins["terrain", "stair"]
    assert re.search(r"stair\.py:\d+$", stair["source"])
    rise = next(field for field in stair["fields"] if field["name"] == "rise")
    assert (rise["default"], rise["bounds"], rise["unit"]) == (0.2, "> 0, ≤ 0.5", "m")
    assert "rise" in call("inspect", "plugins", "stair", cwd=tmp_path).out


def test_inspect_terrain_draws_and_measures(tmp_path: Path) -> None:
    done = call("inspect", "terrain", "stair", "--output", "s.png", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    draw = json.loads(done.out)["draws"][0]
    assert draw["largest_face"] == pytest.approx(0.2)
    assert abs(draw["climb"]) in [pytest.approx(0.2 * steps) for steps in (3, 4, 5)]
    assert "[m]" in (drawn := call("inspect", "terrain", "stair", cwd=tmp_path).out)
    equal = call("inspect", "terrain", "paper_step", cwd=tmp_path).out  # the same for each seed
    assert len(drawn.splitlines()) == len(equal.splitlines()) + 3
    assert "any" in equal
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")


def test_inspect_reward_audits_every_term(tmp_path: Path) -> None:
    sought = ["+reward@rewards.hit=impact", "rewards.hit.weight=-2"]  # as if blows were wanted
    options = ["--episodes", "2", "--json"]
    done = call("inspect", "reward", "terrain=step", *sought, *options, cwd=tmp_path)
    terms = json.loads(done.out)["terms"]
    assert set(terms) == {"flipper", "pitch", "end", "hit"}
    assert 0 <= terms["hit"]["saturated"] < 0.5
    assert sum(term["share"] for term in terms.values()) == pytest.approx(1.0)
    assert 0 <= terms["pitch"]["saturated"] <= 1
    assert terms["end"]["saturated"] is None


def test_inspect_checkpoint_needs_no_plugin(run: Path, tmp_path: Path) -> None:
    for name in (checkpoint.BEST, checkpoint.LAST):
        done = call("inspect", "checkpoint", str(run / name), "--json", cwd=tmp_path)
        document = json.loads(done.out)
        assert document["config"]["terrain"]["name"] == "step"
        assert call("inspect", "checkpoint", str(run / name), cwd=tmp_path).code == 0


def test_inspect_run_plots_learning_curves(run: Path, tmp_path: Path) -> None:
    done = call("inspect", "run", str(run), "--output", "curves.svg", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    document = json.loads(done.out)
    assert document["summary"]["finished"] is True
    assert [v["decision"] for v in document["validations"]][-1] == RUN["train.decisions"]
    assert (tmp_path / "curves.svg").read_text().lstrip().startswith("<?xml")


def test_inspect_config_is_what_a_training_would_use(tmp_path: Path) -> None:
    done = call("inspect", "config", "terrain=step", "~rewards.pitch", "--json", cwd=tmp_path)
    document = json.loads(done.out)
    assert document["terrain"]["name"] == "step"
    assert set(document["rewards"]) == {"flipper", "end"}
    added = call(
        "inspect", "config", "+reward@rewards.again=pitch", "rewards.again.weight=0.5", cwd=tmp_path
    )
    assert "weight: 0.5" in added.out


def test_a_plugin_file_is_usable_at_once(tmp_path: Path) -> None:
    (tmp_path / "ridge.py").write_text(RIDGE)
    options = ["--plugins", "ridge.py"]
    done = call("train", "terrain=ridge", "terrain.height=0.1", *QUICK, *options, cwd=tmp_path)
    assert done.code == 0, done.err
    (made,) = (tmp_path / "runs" / "ridge").iterdir()
    evaluated = call(
        "eval", "--checkpoint", str(made), "--episodes", "2", "--jobs", "2", *options, cwd=tmp_path
    )
    assert evaluated.code == 0, evaluated.err
    without = call("eval", "--checkpoint", str(made), cwd=tmp_path)
    assert without.code == 2
    assert "terrain plugin 'ridge'" in without.err


RIDGE = '''
import numpy as np
from pydantic import Field
from flipperctl.api import Profile, Terrain, terrain

@terrain("ridge")
class Ridge(Terrain):
    """One triangular ridge across the track."""
    height: float = Field(0.2, gt=0, le=0.4, description="ridge height [m]")

    def generate(self, rng: np.random.Generator) -> Profile:
        return Profile([(0, 0), (0.3, self.height), (0.6, 0)])
'''
