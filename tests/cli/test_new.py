"""``flipperctl new``: what it writes works as it is, and nothing is ever overwritten."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.call import RUN, Done, call, refused

ROOT = Path(__file__).parents[2]
KINDS = ("terrain", "reward", "network", "controller", "engine", "sensor", "measure", "logger")
QUICK = [f"{key}={value}" for key, value in RUN.items()]


@pytest.fixture(scope="module")
def drafts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Done]:
    """One file and one package of each kind, and the output; ``folder`` holds them."""
    folder = tmp_path_factory.mktemp("drafts")
    results = {}
    for kind in KINDS:
        results[kind] = call("new", kind, f"my_{kind}", cwd=folder)
        results[f"{kind} package"] = call("new", kind, f"our_{kind}", "--package", cwd=folder)
    assert [done.err for done in results.values() if done.code] == []
    return {**results, "folder": Done(0, str(folder), "")}


@pytest.fixture(scope="module")
def folder(drafts: dict[str, Done]) -> Path:
    return Path(drafts["folder"].out)


def test_from_new_to_an_evaluated_policy_in_the_three_commands_it_prints(
    drafts: dict[str, Done], folder: Path
) -> None:
    lines = [shlex.split(line) for line in drafts["terrain"].out.splitlines()]
    before = (folder / "my_terrain.py").read_bytes()
    (train,) = [line[1:] for line in lines if line[:2] == ["flipperctl", "train"]]
    done = call(*train, *QUICK, cwd=folder)
    assert done.code == 0, done.err
    (evaluation,) = [line[1:] for line in lines if line[:2] == ["flipperctl", "eval"]]
    done = call(*evaluation, "--episodes", "2", "--json", cwd=folder)
    assert done.code == 0, done.err
    assert json.loads(done.out)["scenes"][0]["terrain"] == "my_terrain"
    assert (folder / "my_terrain.py").read_bytes() == before


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_new_passes_the_conformance_suite(
    kind: str, drafts: dict[str, Done], folder: Path
) -> None:
    (check,) = [line for line in drafts[kind].out.splitlines() if "inspect plugins" in line]
    done = call(*shlex.split(check)[1:], cwd=folder)
    assert done.code == 0, done.err
    shown = {"engine": "sim", "sensor": "perception"}.get(kind, kind)
    assert f"{shown} my_{kind}" in done.out


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("reward", ["inspect", "reward", "+reward@rewards.mine=my_reward", "terrain=step"]),
        ("network", ["inspect", "config", "network=my_network"]),
        ("controller", ["eval", "--controller", "my_controller", "terrain=step"]),
        ("engine", ["eval", "--controller", "okada", "sim=my_engine", "terrain=step"]),
        ("measure", ["eval", "--controller", "okada", "terrain=step"]),
        ("sensor", ["eval", "--controller", "okada", "perception=my_sensor", "terrain=step"]),
    ],
)
def test_what_is_new_is_usable_at_once(kind: str, arguments: list[str], folder: Path) -> None:
    short = [] if "config" in arguments else ["--episodes", "1"]
    done = call(*arguments, *short, "--plugins", f"my_{kind}.py", cwd=folder)
    assert done.code == 0, done.err


def test_a_package_passes_its_own_tests(folder: Path) -> None:
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    command = [sys.executable, "-m", "pytest", "flipperctl_our_reward"]
    done = subprocess.run(command, cwd=folder, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "7 passed" in done.stdout


def test_what_is_new_is_linted_formatted_and_typed(folder: Path) -> None:
    config = str(ROOT / "pyproject.toml")
    for package in (folder, *folder.glob("flipperctl_our_*")):
        for command in (["check"], ["format", "--check"]):
            ruff = [sys.executable, "-m", "ruff", *command, "--no-cache", "--config", config, "."]
            done = subprocess.run(ruff, cwd=package, capture_output=True, text=True)
            assert done.returncode == 0, done.stdout + done.stderr
    # From the root, so that the cache of the project's own check is used; the examples with them.
    examples = (ROOT / "examples").glob("*/src/*/[!_]*.py")
    files = [str(file) for file in (*folder.glob("my_*.py"), *examples)]
    mypy = [sys.executable, "-m", "mypy", "--config-file", config, *files]
    done = subprocess.run(mypy, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("option", [[], ["--package"]], ids=["file", "package"])
def test_nothing_is_overwritten(option: list[str], tmp_path: Path) -> None:
    made = tmp_path / ("flipperctl_mine/pyproject.toml" if option else "mine.py")
    assert call("new", "terrain", "mine", *option, cwd=tmp_path).code == 0
    made.write_text("changed")
    error = refused("new", "reward", "mine", *option, cwd=tmp_path)
    assert "already exists" in error
    assert made.read_text() == "changed"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["terian", "mine"], ["'terian'", "'terrain'"]),
        (["terrain", "My Own"], ["'My Own'", "lower-case letters"]),
        (["terrain", "class"], ["'class'", "word of Python"]),
        (["terrain", "null"], ["'null'", "word of YAML"]),
        (["reward", "signal"], ["'signal'", "standard library", "signal_reward is free"]),
        (["terrain", "torch"], ["'torch'", "the package torch", "torch_terrain is free"]),
        (["network", "flipperctl", "--package"], ["'flipperctl'", "flipperctl_network is free"]),
        (["terrain", "stair"], ["'stair'", "already", "stair.py:"]),
        (["engine", "planar"], ["engine plugin 'planar'", "already", "engine.py:"]),
        (["sensor", "planar"], ["sensor plugin 'planar'", "already", "sensing.py:"]),
        (["terrain", "mine", "--output", "file"], ["file", "cannot be written"]),
        (["terrain", "mine", "--package", "--output", "file"], ["file", "cannot be written"]),
    ],
    ids=" ".join,
)
def test_a_wrong_request_is_named(arguments: list[str], words: list[str], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    error = refused("new", *arguments, cwd=tmp_path)
    assert [word for word in words if word not in error] == [], error


def test_a_name_that_the_contract_uses_makes_another_class(tmp_path: Path) -> None:
    for name, cls in (("outcome", "OutcomeTerrain"), ("none", "NoneTerrain"), ("a_b", "AB")):
        assert call("new", "terrain", name, "--output", "here", cwd=tmp_path).code == 0
        assert f"class {cls}(Terrain)" in (tmp_path / "here" / f"{name}.py").read_text()
    done = call("inspect", "plugins", "outcome", "--plugins", "here", cwd=tmp_path)
    assert done.code == 0, done.err
