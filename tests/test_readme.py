"""What the README shows, works."""

import contextlib
import math
import re
import shlex
from itertools import pairwise
from pathlib import Path
from uuid import uuid4

import pytest

from flipperctl import checkpoint
from flipperctl.api import ACTIONS
from flipperctl.env import flipper_env
from flipperctl.testing import checks
from tests.cli.call import RUN, call

README = (Path(__file__).parents[1] / "README.md").read_text()
SHOWN = "runs/stair/2026-01-31_12-00-00"
RIDGE = "runs/ridge/first"
QUICK = [f"{key}={value}" for key, value in RUN.items()]


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands() -> list[list[str]]:
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [w for w in words if w and w[0] == "flipperctl"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as the README's reader has it: runs on stair and ridge, an export, and ridge.py."""
    folder = tmp_path_factory.mktemp("readme")
    done = call("train", "terrain=stair", f"hydra.run.dir={SHOWN}", *QUICK, cwd=folder)
    assert done.code == 0, done.err
    done = call("export", "onnx", "--checkpoint", SHOWN, "--output", "stair.onnx", cwd=folder)
    assert done.code == 0, done.err
    (ridge,) = [b for b in blocks("python") if '@terrain("ridge")' in b]
    (folder / "ridge.py").write_text(ridge)
    learn = ["terrain=ridge", f"hydra.run.dir={RIDGE}", "--plugins", "ridge.py"]
    done = call("train", *learn, *QUICK, cwd=folder)
    assert done.code == 0, done.err
    return folder


def smaller(command: list[str]) -> list[str]:
    """The same command with a budget for a test; a later override wins."""
    if command[0] == "train" and "--cfg" not in command:
        command = [word.replace("seed=1,2,3,4,5", "seed=1,2") for word in command]
        resumed = "--resume" in command
        trials = ["hydra.sweeper.n_trials=2"] if "hydra/sweeper=optuna" in command else []
        alone = not resumed and "-m" not in command  # two of one second would share a folder
        own = [f"hydra.run.dir=runs/{uuid4()}"] if alone else []
        return [*command, *(["train.decisions=310"] if resumed else QUICK), *trials, *own]
    if command[0] == "bench":
        return [*command, "--small"]
    if command[0] in ("eval", "transfer") or {"--compare", "engines"} & set(command):
        planner = ("--controller", "planner") in pairwise(command)
        words = re.sub(r"--episodes \d+", "", " ".join(command))
        words = re.sub(r"terrain=(\w+,\w+,\w+),[\w,]+", r"terrain=\1", words).split()
        return [*words, "--episodes", "1", *(["controller.budget=2000"] if planner else [])]
    return command


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_every_command_of_the_readme_runs(command: list[str], folder: Path) -> None:
    done = call(*smaller(command[1:]), cwd=folder)
    assert done.code == 0, done.err
    for word, name in pairwise(command):
        if word == "--output":
            assert (folder / name).exists()
    assert (folder / SHOWN / checkpoint.LAST).is_file()


def test_the_environment_example_runs() -> None:
    (example,) = [b for b in blocks("python") if "gymnasium.make" in b]
    names: dict[str, object] = {}
    exec(example, names)
    assert isinstance(names["env"].unwrapped, flipper_env.FlipperEnv)
    assert names["picture"].shape[2] == 3


def test_the_robots_example_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = [b for b in blocks("python") if "OnnxPolicy" in b]
    names: dict[str, object] = {}
    with contextlib.chdir(folder):
        exec(example, names)
    turned = [i * math.pi / 12 for i in ACTIONS[names["action"]]]
    assert names["targets"] == pytest.approx(turned)
    assert names["period"] == pytest.approx(0.6)
    assert "theta_R rad L pitch, nose up positive" in capsys.readouterr().out


@pytest.mark.usefixtures("registry")
def test_the_conformance_example_keeps_the_contract(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = [b for b in blocks("python") if "Conformance" in b]
    monkeypatch.syspath_prepend(folder)
    names: dict[str, object] = {"__name__": "test_ridge"}
    exec(example, names)
    done = {check.name for check in checks(names["TestRidge"].plugin) if check() is None}
    assert {"extent", "start", "picture"} <= done


def test_the_example_plugin_is_the_readmes(tmp_path: Path) -> None:
    example = Path(__file__).parents[1] / "examples" / "ridge.py"
    done = call("inspect", "terrain", "ridge", "--plugins", str(example), cwd=tmp_path)
    assert done.code == 0, done.err
    (shown,) = [b for b in blocks("python") if '@terrain("ridge")' in b]
    assert shown.split("@terrain")[1].split("def")[0] in example.read_text()
