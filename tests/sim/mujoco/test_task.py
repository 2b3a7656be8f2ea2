"""The whole task in 3-D: environment, evaluation and training take the engine by its name."""

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from flipperctl import checkpoint
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.pictures import HEIGHT, WIDTH
from flipperctl.errors import PluginFailedError, RequestError, TerrainError
from flipperctl.sim.mujoco import world as placing
from flipperctl.sim.mujoco.world import MujocoWorld
from tests.cli.call import EXACT, call

DRAWS_HERE = any(ctypes.util.find_library(name) for name in ("EGL", "OSMesa"))


def test_the_environment_keeps_gymnasiums_contract() -> None:
    env = gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain="stair", sim="mujoco")
    check_env(env.unwrapped, skip_render_check=True)
    first, second = (env.reset(seed=3)[0] for _ in range(2))
    assert np.array_equal(first, second)
    env.close()


@pytest.mark.parametrize("sim", [{"roughness": 0.1}, {"yaw": 0.7, "offset": 0.3}], ids=str)
def test_a_start_on_a_slope_lies_on_what_stands_above_the_line(
    sim: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = {"name": "building_stair", "fewest": 8, "most": 16}
    ground = {"name": "midway", "terrain": inner, "start": 1.0}
    env = FlipperEnv(ground, sim={"name": "mujoco", **sim})

    def begin() -> None:
        for seed in range(8):
            env.reset(seed=seed)

    begin()
    monkeypatch.setattr(placing, "OVERLAP", 1.0)
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin()


def test_a_turned_robot_starts_behind_the_edge_that_its_corner_would_overlap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def begin(sim: dict[str, float], run_up: float) -> list[float]:
        env = FlipperEnv(
            {"name": "step", "low": 0.2, "high": 0.3},
            sim={"name": "mujoco", **sim},
            episode={"run_up": run_up, "start_noise": 0.0, "start_angle": 0.0},
        )
        found = []
        for seed in range(8):
            env.reset(seed=seed)
            found.append(env.drive.world.position[0] - env.profile.start)
        return found

    (straight, *_), turned = begin({}, 0.78), begin({"yaw": 0.4}, 0.78)
    assert min(turned) < straight - 0.01
    assert min(turned) >= straight - 0.36 * 0.4
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin({}, 0.7)
    monkeypatch.setattr(placing, "OVERLAP", 1.0)
    with pytest.raises(TerrainError, match="overlaps the robot at the start by"):
        begin({"yaw": 0.4}, 0.78)


@pytest.mark.skipif(not DRAWS_HERE, reason="this machine has neither EGL nor OSMesa")
def test_render_shows_the_world_in_3d_and_leaves_the_episode_alone() -> None:
    drawn, plain = (
        FlipperEnv("step", sim="mujoco", render_mode=mode) for mode in ("rgb_array", None)
    )
    observations = [env.reset(seed=2)[0] for env in (drawn, plain)]
    for action in (8, 0, 4):
        picture = drawn.render()
        assert picture is not None
        assert (picture.shape, picture.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
        assert np.array_equal(picture, drawn.render())
        orange = (picture[..., 0] > 150) & (picture[..., 2] < 60)  # boards of the tracks
        assert orange.sum() > 1000
        assert np.array_equal(*observations)
        observations = [env.step(action)[0] for env in (drawn, plain)]
    assert plain.render() is None


def test_render_names_what_is_missing_and_whose_fault_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env = FlipperEnv("step", sim="mujoco", render_mode="rgb_array")
    env.reset(seed=2)
    with monkeypatch.context() as patched:
        patched.delenv("MUJOCO_GL", raising=False)
        patched.setattr(ctypes.util, "find_library", lambda name: None)
        with pytest.raises(RequestError, match="has neither EGL nor OSMesa: on Debian"):
            env.render()

    def draw(self: MujocoWorld, width: int, height: int) -> np.ndarray:
        raise ValueError("no colours")

    monkeypatch.setattr(MujocoWorld, "draw", draw)
    with pytest.raises(PluginFailedError, match="sim 'mujoco': draw raised ValueError: no colours"):
        env.render()


@pytest.mark.slow
def test_an_unknown_drawing_library_is_one_error() -> None:
    # In a process of its own, since MuJoCo reads the variable when it is imported.
    asked = ["eval", "--controller", "okada", "--episodes", "1", "sim=mujoco", "terrain=step"]
    done = subprocess.run(
        [sys.executable, "-m", "flipperctl", *asked],
        env={**os.environ, "MUJOCO_GL": "wrong"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "error: sim=mujoco: MuJoCo does not import with MUJOCO_GL=wrong" in done.stderr
    assert "Traceback" not in done.stderr


def test_eval_repeats_bit_for_bit_and_with_several_processes(tmp_path: Path) -> None:
    asked = ["eval", "--controller", "okada", "terrain=step", "sim=mujoco", "sim.yaw=0.1"]
    runs = [
        json.loads(call(*asked, "--episodes", "2", "--jobs", jobs, "--json", cwd=tmp_path).out)
        for jobs in ("1", "2")
    ]
    assert runs[0] == runs[1]
    assert runs[0]["scenes"][0]["success_rate"] == 1.0


@pytest.mark.slow
def test_a_policy_is_trained_in_3d_and_evaluated_in_the_plane(tmp_path: Path) -> None:
    settings = [f"{key}={value}" for key, value in EXACT.items()]
    run = ["terrain=step", "sim=mujoco", "hydra.run.dir=run", *settings]
    done = call("train", *run, cwd=tmp_path)
    assert done.code == 0, done.err
    read = checkpoint.read(tmp_path / "run" / checkpoint.LAST)
    assert read.config().sim.plugin_name == "mujoco"
    other = call("eval", "run", "sim=planar,mujoco", "--episodes", "1", "--json", cwd=tmp_path)
    assert other.code == 0, other.err
    (found,) = json.loads(other.out)["engines"]
    assert found["engines"] == ["planar", "mujoco"]
