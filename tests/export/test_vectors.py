"""Vectors for ports, and the port to C++ that is compared with them."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.export.policy import save_network
from flipperctl.runtime import OnnxPolicy
from tests.cli.call import call

PORT = Path(__file__).parents[2] / "examples" / "cpp"


@pytest.fixture(scope="module", params=["pairs", "four"])
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The vectors of a policy with three frames, whose sensor has gaps, or of four with sides."""
    folder = tmp_path_factory.mktemp("vectors")
    words = ["p.onnx", "terrain=stair", "--output", "v.json"]
    if request.param == "four":
        settings = {"robot": {"flippers": "four"}, "perception": {"sides": True}}
        env, network = FlipperEnv("stair", sim="mujoco", **settings), torch.nn.Linear(96, 81)
        save_network(network, env.config, folder / "p.onnx", 0, "turns")
        words += ["sim=mujoco", "sim.one_sided=1"]
    else:
        assert call("export", "onnx", "generalist", "--output", "p.onnx", cwd=folder).code == 0
        words += ["perception.occlusion=true"]
    done = call("export", "vectors", *words, cwd=folder)
    assert done.code == 0, done.err
    return folder


def test_vectors_are_what_the_runtime_answers(folder: Path) -> None:
    document = json.loads((folder / "v.json").read_text())
    policy = OnnxPolicy(folder / "p.onnx", escape=False)
    assert len(document["instants"]) == 200
    assert document["frames"] == policy.interface.frames
    four = len(policy.interface.joints) > 2
    assert four == document.get("sides", False)
    before = None
    for row in document["instants"]:
        if row["episode"] != before:
            policy.reset()
            before = row["episode"]
        measured = row.get("flippers", [row["front"], row["rear"]])
        half = len(measured) // 2
        sides = {"sides": (row["left"], row["right"]), "roll": row["roll"]} if four else {}
        observation = policy.observation(
            row["points"],
            front=measured[:half],
            rear=measured[half:],
            pitch=row["pitch"],
            **sides,
        )
        assert observation.tolist() == row["observation"]
        assert policy.act(observation) == row["action"] == int(np.argmax(row["q_values"]))
        after = policy.next_targets(row["targets_before"], measured, row["action"])
        assert after.tolist() == row["targets"]
    if four:  # the obstacles stand below one side
        first = document["instants"][0]["observation"]
        assert max(map(abs, np.subtract(first[30:60], first[60:90]))) > 0.05


def test_the_port_to_cpp_agrees(folder: Path) -> None:
    compiler = shutil.which("c++") or shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    program = folder / "check"
    flags = "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror"
    subprocess.run([compiler, *flags, PORT / "check.cpp", "-o", program], check=True)
    command = [sys.executable, str(PORT / "check.py"), str(folder / "v.json")]
    numbers = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    done = subprocess.run([program], input=numbers, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("200 instants: inputs differ by")
    # A port that is wrong is found: another limit of the targets.
    lines = numbers.splitlines()
    head = lines[0].split()
    head[6] = "0.2"
    wrong = subprocess.run([program], input="\n".join([" ".join(head), *lines[1:]]), text=True)
    assert wrong.returncode == 1


def test_vectors_are_of_an_exported_file(tmp_path: Path) -> None:
    done = call("export", "vectors", "generalist", cwd=tmp_path)
    assert done.code == 2
    error = done.err.splitlines()[-1]
    assert error.startswith("error: generalist is no exported policy; write one by flipperctl exp")
