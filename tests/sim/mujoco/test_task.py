"""The whole task in 3-D: environment, evaluation and training take the engine by its name."""

import json
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.utils.env_checker import check_env

from flipperctl import checkpoint
from tests.cli.call import RUN, call


def test_the_environment_keeps_gymnasiums_contract() -> None:
    env = gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain="stair", sim="mujoco")
    check_env(env.unwrapped, skip_render_check=True)
    first, second = (env.reset(seed=3)[0] for _ in range(2))
    assert np.array_equal(first, second)
    env.close()


def test_eval_repeats_bit_for_bit_and_with_several_processes(tmp_path: Path) -> None:
    asked = ["eval", "--controller", "okada", "terrain=step", "sim=mujoco", "sim.yaw=0.1"]
    runs = [
        json.loads(call(*asked, "--episodes", "2", "--jobs", jobs, "--json", cwd=tmp_path).out)
        for jobs in ("1", "2")
    ]
    assert runs[0] == runs[1]
    assert runs[0]["scenes"][0]["success_rate"] == 1.0


def test_a_policy_is_trained_in_3d_and_evaluated_in_the_plane(tmp_path: Path) -> None:
    settings = [f"{key}={value}" for key, value in RUN.items()]
    run = ["terrain=step", "sim=mujoco", "hydra.run.dir=run", "train.mode=exact", *settings]
    done = call("train", *run, cwd=tmp_path)
    assert done.code == 0, done.err
    read = checkpoint.read(tmp_path / "run" / checkpoint.LAST)
    assert read.config().sim.plugin_name == "mujoco"
    other = call("transfer", "--checkpoint", "run", "--episodes", "1", "--json", cwd=tmp_path)
    assert other.code == 0, other.err
    (scene,) = json.loads(other.out)["scenes"]
    assert scene["engines"] == ["planar", "mujoco"]
