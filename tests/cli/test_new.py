"""``flipperctl new``: what it writes works as it is; ``inspect plugins --check``."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.call import EXACT, Done, call, refused

ROOT = Path(__file__).parents[2]
KINDS = (
    "terrain",
    "reward",
    "network",
    "controller",
    "engine",
    "sensor",
    "measure",
    "logger",
    "command",
)
QUICK = [f"{key}={value}" for key, value in EXACT.items()]


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


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.long] * (k == "network")) for k in KINDS]
)
def test_what_is_new_passes_the_conformance_suite(
    kind: str, drafts: dict[str, Done], folder: Path
) -> None:
    (check,) = [line for line in drafts[kind].out.splitlines() if "inspect plugins" in line]
    done = call(*shlex.split(check)[1:], cwd=folder)
    assert done.code == 0, done.err
    shown = {"engine": "sim", "sensor": "perception"}.get(kind, kind)
    name = "my-command" if kind == "command" else f"my_{kind}"  # as it is typed
    assert f"{shown} {name}" in done.out


@pytest.mark.long
def test_a_package_passes_its_own_tests(folder: Path) -> None:
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST")}
    command = [sys.executable, "-m", "pytest", "flipperctl_our_reward"]
    done = subprocess.run(command, cwd=folder, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "8 passed" in done.stdout


def test_what_is_new_is_linted_and_formatted(folder: Path) -> None:
    config = str(ROOT / "pyproject.toml")
    for command in (["check"], ["format", "--check"]):
        ruff = [sys.executable, "-m", "ruff", *command, "--no-cache", "--config", config, "."]
        done = subprocess.run(ruff, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
def test_what_is_new_is_typed(folder: Path) -> None:
    # From the root, so that the cache of the project's own check is used; the examples with them.
    examples = (ROOT / "examples").glob("*/src/*/[!_]*.py")
    files = [str(file) for file in (*folder.glob("my_*.py"), *examples)]
    config = str(ROOT / "pyproject.toml")
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


WALL = '''
from pydantic import Field
from flipperctl.api import Profile, Terrain, terrain

@terrain("wall")
class Wall(Terrain):
    """A wall."""
    height: float = Field(0.2, ge=0, le=30, description="height [m]")

    def generate(self, rng):
        return Profile([(0, 0), (0, self.height)])
'''


def test_a_plugin_that_fails_is_named_with_check_and_value(tmp_path: Path) -> None:
    (tmp_path / "wall.py").write_text(WALL)
    check = ["inspect", "plugins", "wall", "--check", "--plugins", "wall.py"]
    done = call(*check, cwd=tmp_path)
    assert done.code == 1
    assert done.err == "error: 1 of 9 checks failed: terrain wall (profiles)\n"
    assert "with height=30: it reaches 30 m" in " ".join(done.out.split())
    rows = {row["check"]: row for row in json.loads(call(*check, "--json", cwd=tmp_path).out)}
    assert [name for name, row in rows.items() if not row["ok"]] == ["profiles"]
    assert "20 m is allowed" in rows["profiles"]["message"]
    assert rows["start"]["seconds"] > 0
