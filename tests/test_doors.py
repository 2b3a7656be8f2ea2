"""What a stranger adds comes in by the same doors as what is built in.

Each door is one file of the examples in an empty folder, and no class of a plugin is asked for
outside its family's room.
"""

import ast
import importlib.util
import os
import pkgutil
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

import pytest

from flipperctl.api import action_index, registry
from flipperctl.api.controllers import plans_on_rewards
from flipperctl.config import EvalConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.plugging import plugins
from flipperctl.policies.source import PolicySource, with_files
from flipperctl.rollout.episode import decisions
from tests.cli.call import call, refused

ROOT = Path(__file__).parents[1]
ROOMS = {"flipperctl": ROOT / "flipperctl", "flipperctl_plugins": ROOT / "plugins"}
CLASSES = ("isinstance", "issubclass")


def modules() -> Iterator[tuple[str, Path]]:
    for package, folder in ROOMS.items():
        for file in folder.rglob("*.py"):
            parts = file.relative_to(folder).with_suffix("").parts
            yield ".".join([package, *parts]).removesuffix(".__init__"), file


def classes_asked_for(module: str, file: Path) -> Iterator[tuple[int, type]]:
    """Yield line and class of each class that the code compares an object with."""
    tree = ast.parse(file.read_text())
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    imported: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            imported |= {name.asname or name.name: f"{base}.{name.name}" for name in node.names}
        elif isinstance(node, ast.Import):
            imported |= {name.asname or name.name: name.name for name in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in CLASSES:
            asked = node.args[1]
        elif isinstance(node, ast.MatchClass):
            asked = node.cls
        elif isinstance(node, ast.Compare) and ast.unparse(node.left).startswith("type("):
            asked = node.comparators[0]
        else:
            continue
        for part in ast.walk(asked):
            if isinstance(part, ast.Name | ast.Attribute):
                first, _, rest = ast.unparse(part).partition(".")
                path = f"{imported.get(first, f'{module}.{first}')}{'.' if rest else ''}{rest}"
                if path.partition(".")[0] in ROOMS:
                    with suppress(ImportError, AttributeError):  # an attribute of some value
                        if isinstance(cls := pkgutil.resolve_name(path), type):
                            yield node.lineno, cls


def test_no_class_of_a_plugin_is_asked_for_outside_its_room() -> None:
    """A room is the folder of the class; a base of plugins counts unless the contract has it."""
    bases = {base for cls in registry.values() for base in cls.__mro__}
    ours = {cls for cls in bases if cls.__module__.partition(".")[0] in ROOMS}
    ours = {cls for cls in ours if not cls.__module__.startswith("flipperctl.api.")}
    assert len(ours) > len(registry) / 2
    asked = [
        f"{module}:{line}: {cls.__qualname__}"
        for module, file in modules()
        for line, cls in classes_asked_for(module, file)
        if cls in ours and not module.startswith(cls.__module__.rpartition(".")[0])
    ]
    assert asked == []


@pytest.mark.usefixtures("registry")
def test_a_planner_is_given_the_rewards_as_ours_is(tmp_path: Path) -> None:
    plugins.load([ROOT / "examples" / "nearsighted.py"])
    config = EvalConfig(terrain="step", rewards={"end": {"name": "end", "weight": 2.5}})
    for name in ("nearsighted", "value_iteration"):
        planner = resolver.create("controller", name, "controller")
        assert plans_on_rewards(planner)
        assert PolicySource(settings={"name": name}).plans_for_rewards
        assert with_files(planner, config)._rewards == config.rewards
    assert not PolicySource(settings={"name": "mpc"}).plans_for_rewards


@pytest.mark.usefixtures("registry")
def test_a_planner_drives_for_the_rewards_of_the_user(tmp_path: Path) -> None:
    plugins.load([ROOT / "examples" / "nearsighted.py"])
    source = PolicySource(settings={"name": "nearsighted", "ahead": 1})
    held, unpaid = (EvalConfig(terrain="flat", rewards=paid) for paid in ({"travel": "travel"}, {}))
    for config, action in ((held, action_index(0, 0)), (unpaid, 0)):  # any is as good as the first
        driven = decisions(FlipperEnv(config=config), source.build(config), seed=1)
        assert [decision.action for decision in islice(driven, 3)] == [action] * 3


def test_a_subcommand_of_a_file_is_like_ours(tmp_path: Path) -> None:
    file = Path(shutil.copy(ROOT / "examples" / "rougher.py", tmp_path)).name
    done = call("rougher", "level", "--episodes", "1", "--plugins", file, cwd=tmp_path)
    assert done.code == 0, done.err
    assert re.fullmatch(r"step: \d\.\d\d rad\nramp: \d\.\d\d rad\n", done.out)
    assert (
        "flipperctl rougher okada"
        in call("rougher", "--help", f"--plugins={file}", cwd=tmp_path).out
    )
    wrong = ["rougher", "--plugins", file]
    assert "given twice: 3 and 4" in refused(
        *wrong, "--episodes", "3", "--episodes=4", cwd=tmp_path
    )
    assert "did you mean '--episodes'" in refused(*wrong, "level", "--episode", "3", cwd=tmp_path)
    assert "Missing argument" in refused(*wrong, cwd=tmp_path)
    shown = call("inspect", "plugins", "rougher", "--plugins", file, cwd=tmp_path).out
    assert re.search("command +rougher", shown)


def test_a_subcommand_that_fails_names_its_line(tmp_path: Path) -> None:
    file = Path(shutil.copy(ROOT / "examples" / "rougher.py", tmp_path))
    file.write_text(file.read_text().replace("    terrains =", "    1 / 0\n    terrains ="))
    error = refused("rougher", "level", "--plugins", file.name, cwd=tmp_path, code=1)
    assert "command 'rougher': rougher raised ZeroDivisionError: " in error
    assert re.search(r"rougher\.py:\d+\)", error)


def test_installed_subcommands_are_listed_and_a_broken_one_is_a_warning(tmp_path: Path) -> None:
    """Each is in a package of its own; ``robot`` is a group of ours."""
    for name, typed, body in (
        ("whole", "robot.tally", "def run(): 'Count the robots.'; print(1)"),
        ("half", "half", "import no_such_library"),
        ("split", "split", "def run(): 'Split hairs.'; 1 / 0"),
    ):
        (tmp_path / f"a_{name}.py").write_text(f"{body}\n")
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[flipperctl.commands]\n{typed} = a_{name}:run\n")

    def typed(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "flipperctl", *words],
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )

    assert "Count the robots" in typed("robot", "--help").stdout
    assert typed("robot", "tally").stdout == "1\n"
    listed = typed("--help")
    assert listed.returncode == 0
    assert "│ watch " in listed.stdout
    assert "warning: half: plugin 'half' of the installed package half" in listed.stderr
    failed = typed("half")
    assert failed.returncode == 2
    assert "a_half.py:1: ModuleNotFoundError" in failed.stderr
    failed = typed("split")
    assert failed.returncode == 1
    assert "command 'split': run raised ZeroDivisionError" in failed.stderr
    assert "a_split.py:1)" in failed.stderr


@pytest.mark.parametrize(
    ("name", "words"), [("highest", []), ("comfort", ["rewards.comfort=comfort"])]
)
def test_a_measure_and_a_reward_of_a_file_are_in_the_result(
    name: str, words: list[str], tmp_path: Path
) -> None:
    file = Path(shutil.copy(ROOT / "examples" / f"{name}.py", tmp_path)).name
    more = ["--episodes", "1", "--baseline", "none", "--output", "result", "--plugins", file]
    done = call("eval", "level", "terrain=flat", *words, *more, cwd=tmp_path)
    assert done.code == 0, done.err
    head = (tmp_path / "result" / "episodes.csv").read_text().partition("\n")[0]
    assert name in head
