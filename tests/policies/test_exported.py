"""An exported policy in the simulator: it acts as its checkpoint, with its own settings."""

from pathlib import Path

import numpy as np
import pytest

from flipperctl import checkpoint
from flipperctl.api import Robot
from flipperctl.config import EnvConfig, EvalConfig
from flipperctl.errors import CheckpointError, PluginError, PolicyError
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.export.policy import export
from flipperctl.policies.exported import exported_config
from flipperctl.policies.source import PolicySource
from tests.cli.call import call
from tests.played import play_episodes
from tests.runtime import linear


@pytest.fixture(scope="module")
def exported(short_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "step.onnx"
    export(checkpoint.read(short_run / checkpoint.BEST), "onnx", path)
    return path


def test_the_exported_policy_acts_as_the_trained_one(short_run: Path, exported: Path) -> None:
    config = EvalConfig(terrain="step", eval={"seed": 1})
    trained = PolicySource(checkpoint=short_run / checkpoint.BEST)
    robot = PolicySource(checkpoint=exported)
    expected = play_episodes(config, trained, episodes=3, seed=1)
    assert play_episodes(config, robot, episodes=3, seed=1) == expected
    with EpisodeWorkers(2) as workers:
        assert list(workers.play(config, robot, range(3))) == expected


def test_the_file_holds_its_terrain_robot_and_layout(exported: Path, tmp_path: Path) -> None:
    config = exported_config(exported)
    assert config.terrain.plugin_name == "step"
    robot = {"chassis_length": 0.9, "flipper_length": 0.5}
    flat = {"terrain": "flat", "terrain_config": {"name": "flat"}}
    path = linear.write(tmp_path / "p.onnx", robot=robot, bin_width=0.1, **flat)
    config = exported_config(path)
    assert config.terrain.plugin_name == "flat"
    assert config.robot.chassis_length == 0.9
    assert config.perception.bin_width == 0.1


def test_a_policy_of_a_mix_is_evaluated_on_that_mix(tmp_path: Path) -> None:
    mix = {
        "name": "mix",
        "parts": [{"name": "step", "low": 0.1, "high": 0.2}, {"name": "ramp", "length_low": 0.9}],
        "weights": [1.0, 2.0],
    }
    path = linear.write(tmp_path / "p.onnx", terrain="mix", terrain_config=mix)
    assert exported_config(path).terrain == EnvConfig(terrain=mix).terrain


def test_another_layout_is_refused(exported: Path) -> None:
    config = EnvConfig(terrain="flat", perception={"bins": 11})
    with pytest.raises(CheckpointError, match=r"15 bins of 0\.15 m.*ask for 11"):
        PolicySource(checkpoint=exported).build(config)


def test_a_terrain_that_is_not_installed_is_named_and_not_needed_on_another(tmp_path: Path) -> None:
    moon = {"terrain": "moon", "terrain_config": {"name": "moon", "craters": 3}}
    robot = {"robot": Robot().model_dump(exclude_none=True)}
    linear.write(tmp_path / "p.onnx", **moon, **robot)
    mix = {"name": "mix", "parts": [{"name": "moon", "craters": 3}, {"name": "step"}]}
    linear.write(tmp_path / "mix.onnx", **robot, terrain="mix", terrain_config=mix)
    for name in ("p.onnx", "mix.onnx"):
        with pytest.raises(PluginError, match="there is no terrain plugin 'moon'; install it or"):
            exported_config(tmp_path / name).terrain.generate(np.random.default_rng(0))
        evaluate = ("eval", "--checkpoint", name, "--episodes", "1")
        done = call(*evaluate, cwd=tmp_path)
        assert (done.code, done.err.count("\n")) == (2, 1)
        assert done.err.startswith(f"error: {name}: there is no terrain plugin 'moon'; install it")
        assert call(*evaluate, "terrain=flat", cwd=tmp_path).code == 0
    # Of the mix only a part is missing; the mix at its own defaults is another terrain.
    assert (
        call(
            "eval", "--checkpoint", "mix.onnx", "terrain=mix", "--episodes", "1", cwd=tmp_path
        ).code
        == 0
    )


def test_a_terrain_with_wrong_settings_is_still_refused(tmp_path: Path) -> None:
    stair = {"name": "stair", "rise": -1}
    path = linear.write(tmp_path / "p.onnx", terrain="stair", terrain_config=stair)
    with pytest.raises(PolicyError, match=r"terrain\.rise: .*greater than 0"):
        exported_config(path)


def test_eval_takes_an_exported_file(exported: Path, tmp_path: Path) -> None:
    done = call("eval", "--checkpoint", str(exported), "--episodes", "1", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert '"terrain": "step"' in done.out
    (tmp_path / "no.onnx").write_text("no")
    done = call("eval", "--checkpoint", "no.onnx", cwd=tmp_path)
    assert done.code == 2
    assert done.err.startswith("error: no.onnx is damaged, or not a file of flipperctl export")
    assert done.err.count("\n") == 1
    damaged = bytearray(exported.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "damaged.onnx").write_bytes(damaged)
    done = call("eval", "--checkpoint", "damaged.onnx", "--json", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert done.err == (
        "error: damaged.onnx is damaged, or was changed since its export: "
        "its SHA-256 does not match its contents\n"
    )
