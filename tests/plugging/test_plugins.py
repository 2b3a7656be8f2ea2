"""How plugins are found, and what a user reads when one cannot be."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import Field

from flipperctl import api
from flipperctl.api.plugin import registered_names
from flipperctl.cli.catalogue import entries
from flipperctl.config import resolver
from flipperctl.config.identity import foreign_sources
from flipperctl.errors import ConfigError, PluginError
from flipperctl.evaluation.plan import find_suite
from flipperctl.plugging import plugins
from flipperctl.requests.compose import compose_environment, compose_train, only_one
from flipperctl.requests.text import from_words

pytestmark = pytest.mark.usefixtures("registry")


def write(path: Path, name: str = "ridge", body: str = "") -> Path:
    """A plugin file with one terrain."""
    path.write_text(
        f"""\
from flipperctl.api import Profile, Terrain, terrain
{body}
@terrain("{name}")
class Ridge(Terrain):
    def generate(self, rng):
        return Profile([(0, 0), (0.3, 0.2), (0.6, 0)])
"""
    )
    return path


def test_files_folders_and_the_variable_give_plugins_and_nothing_else_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path / "one.py", "one")
    (folder := tmp_path / "folder").mkdir()
    for name in ("two.py", "_private.py"):
        write(folder / name, name.removesuffix(".py").strip("_"))
    write(tmp_path / "three.py", "pitch")  # a name is free in another family
    monkeypatch.chdir(tmp_path)
    plugins.load()
    assert not {"one", "two"} & set(registered_names("terrain"))
    monkeypatch.setenv("FLIPPERCTL_PLUGINS", f"{file}{os.pathsep}{folder}")
    before = dict(os.environ)
    for _ in range(2):  # each is executed once
        plugins.load(["three.py"])
    assert {"flat", "one", "two", "pitch"} <= set(registered_names("terrain"))
    assert "private" not in registered_names("terrain")
    assert {"flipper", "pitch", "end"} <= set(registered_names("reward"))
    paths = {str(file), str(folder), str(tmp_path / "three.py")}
    assert set(plugins.configured_paths()) == paths
    assert dict(os.environ) == before
    assert resolver.create("terrain", "one", "terrain").generate(None).end == 0.6


@pytest.mark.parametrize(
    ("name", "body", "text"),
    [
        ("a.py", "import no_such_library", r"a\.py:2: ModuleNotFoundError: .*'no_such_library'"),
        ("a.py", "height: = 0.2", r"a\.py:2: invalid syntax"),
        ("a.py", "from heights import H", r"beside it: write from \.heights import"),
        ("gone.py", "", "gone.py .*does not exist"),
        ("empty", "", r"empty .*no \.py file"),
        ("heights.py", "", r"heights\.py registers nothing; decorate a class"),
    ],
)
def test_what_cannot_be_loaded_says_where_and_why(
    name: str, body: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "heights.py").write_text("HEIGHT = 0.2\n")
    write(tmp_path / "a.py", body=body)
    with pytest.raises(PluginError, match=text) as error:
        plugins.load([tmp_path / name])
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "old", "text"),
    [
        ("My Ridge", "", "plugin name 'My Ridge'"),
        ("ridge", "terrain", "Ridge is not a RewardTerm"),
        ("stair", "", r"'stair': flipperctl_plugins\.terrains\.stairs\.Stair.*choose another name"),
    ],
)
def test_a_wrong_name_or_family_is_an_error(name: str, old: str, text: str, tmp_path: Path) -> None:
    file = write(tmp_path / "mine.py", name)
    file.write_text(file.read_text().replace(old, "reward") if old else file.read_text())
    with pytest.raises(PluginError, match=text):
        plugins.load([file])


def test_a_file_that_was_changed_is_loaded_anew(tmp_path: Path) -> None:
    """Workers, which begin later, run the new code as well."""
    file = write(tmp_path / "mine.py")
    plugins.load([file])
    before = api.registry["terrain", "ridge"]
    write(file, "other")
    plugins.load()
    assert "ridge" not in registered_names("terrain")
    assert api.registry["terrain", "other"] is not before
    file.write_text("1 / 0")
    with pytest.raises(PluginError, match=r"mine\.py:1: ZeroDivisionError"):
        plugins.load([file])
    plugins.load()  # a call that does not name it goes on without it
    assert str(file) not in plugins.configured_paths()
    assert "other" not in registered_names("terrain")


def test_a_class_may_be_defined_again() -> None:
    for height in (0.1, 0.2):

        @api.terrain("cell")
        class Cell(api.Terrain):
            """As in a cell of a notebook that is run again."""

            def generate(self, rng: object, height: float = height) -> api.Profile:
                return api.Profile([(0, 0), (1, height)])

    assert resolver.create("terrain", "cell", "terrain").generate(None).points[1, 1] == 0.2


def test_a_setting_has_no_alias() -> None:
    with pytest.raises(TypeError, match=r"@terrain\('cell'\): height has an alias"):

        @api.terrain("cell")
        class Cell(api.Terrain):
            height: float = Field(0.1, validation_alias="h")


def test_a_class_without_a_file_is_known_by_its_methods() -> None:
    """As one of a notebook, whose cell may be run again with other code."""
    digests = []
    for height in ("0.1", "0.1", "0.2"):
        space = {"__name__": "no_file", "Terrain": api.Terrain, "Profile": api.Profile}
        exec(f"class Cell(Terrain):\n    def generate(self, rng): Profile([(0, {height})])", space)
        digests += foreign_sources([space["Cell"]()])
    assert digests[0] == digests[1] != digests[2]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages: one that does not import, one with a name that is taken."""
    monkeypatch.setattr(api.plugin, "broken", broken := [])
    monkeypatch.setattr(plugins, "broken", broken)
    for package, body in (
        ("half", "import not_installed_anywhere"),
        ("taken", "from .twice import Ridge"),
    ):
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[flipperctl.plugins]\n{package}_one = {package}\n")
        (tmp_path / package).mkdir()
        write(tmp_path / package / "first.py", f"{package}_ground")
        write(tmp_path / package / "twice.py", "flat")
        (tmp_path / package / "__init__.py").write_text(f"from . import first\n{body}\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_a_broken_package_is_left_out_and_named_where_it_is_missed(installed: Path) -> None:
    plugins.load()
    plugins.load()  # it is not tried again
    half, taken = api.plugin.broken
    assert half.names == {"half_one", "half_ground"}
    assert "half/__init__.py:2: ModuleNotFoundError: No module named 'not_inst" in half.reason
    assert "two terrain plugins are called 'flat'" in taken.reason
    assert "half_ground" not in registered_names("terrain")
    for name in ("half_ground", "half_one", "quarry"):
        with pytest.raises(ConfigError, match=r"does not load: plugin 'half_one' of the installed"):
            resolver.create("terrain", name, "terrain")
    with pytest.raises(ConfigError, match=r"did you mean 'stair'\?"):
        resolver.create("terrain", "stiar", "terrain")


def test_commands_warn_about_a_broken_package_and_show_it(installed: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(installed)}

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "flipperctl", *words]
        return subprocess.run(command, capture_output=True, text=True, env=environment)

    done = run("list", "plugins", "--json")
    assert done.returncode == 0
    assert done.stderr.splitlines() == [
        f"warning: {name} does not load; flipperctl list plugins says why"
        for name in ("half", "taken")
    ]
    shown = {entry["name"]: entry["summary"] for entry in json.loads(done.stdout)["names"]}
    assert shown["half"].startswith("broken: plugin 'half_one'")
    assert re.match(r"\d+: agent d3qn, ", shown["flipperctl"])
    rows = json.loads(run("inspect", "plugins", "--json").stdout)
    assert [row["name"] for row in rows if row["kind"] == "broken"] == ["half_one", "taken_one"]
    named = run("inspect", "plugins", "half_ground")
    assert named.returncode == 2
    assert "ModuleNotFoundError" in named.stderr


@pytest.mark.parametrize("kind", ["terrain", "sensor", "command"])
def test_a_decorator_without_its_name_says_what_to_write(tmp_path: Path, kind: str) -> None:
    file = tmp_path / "bare.py"
    file.write_text(f"from flipperctl.api import {kind}\n@{kind}\nclass Ridge:\n    pass\n")
    with pytest.raises(PluginError, match=rf'bare\.py:2: .*write @{kind}\("ridge"\)'):
        plugins.load([file])


def test_a_plugin_imports_the_files_beside_it(tmp_path: Path) -> None:
    """Also another plugin, in any order of their names; each is executed once."""
    (tmp_path / "heights.py").write_text("HEIGHT = 0.2\n")
    body = "from .heights import HEIGHT\nfrom .zlow import Ridge as Low\n"
    write(tmp_path / "a.py", "aridge", body)
    write(tmp_path / "zlow.py", "zlow")
    plugins.load([tmp_path])
    plugins.load([tmp_path])
    assert {"aridge", "zlow"} <= set(registered_names("terrain"))
    low, ridge = (api.registry["terrain", name] for name in ("zlow", "aridge"))
    assert vars(sys.modules[ridge.__module__])["Low"] is low
    assert (plugins.file_name(low), plugins.file_name(ridge)) == ("zlow.py", "a.py")
    (before,) = foreign_sources([ridge()])
    (tmp_path / "heights.py").write_text("HEIGHT = 0.3\n")
    assert foreign_sources([ridge()]) != [before]  # stored episodes are played anew
    plugins.load([tmp_path])
    assert api.registry["terrain", "aridge"] is not ridge


def test_presets_beside_a_plugin_are_found_by_one_rule(tmp_path: Path) -> None:
    file = write(tmp_path / "ridge.py")
    presets = {
        "suite/ridges": "about: Ridges.\nscenes:\n  low: terrain=ridge\n",
        "experiment/ridge_fast": "# @package _global_\ndefaults:\n  - override /terrain: ridge\n"
        "  - override /rewards: calm\n  - override /robot: short\nseed: 7\n",
        "conditions/slippery": "# @package _global_\nsim:\n  friction: 0.5\n",
        "rewards/calm": "defaults:\n  - /reward@end: end\n  - _self_\n",
        "robot/short": "chassis_length: 0.4\n",
    }
    for name, text in presets.items():
        (tmp_path / name).parent.mkdir()
        (tmp_path / f"{name}.yaml").write_text(text)
    plugins.load([file])
    config = only_one(compose_train(from_words(["experiment=ridge_fast"])))
    assert (config.terrain.plugin_name, config.seed, list(config.rewards)) == ("ridge", 7, ["end"])
    assert config.robot.chassis_length == resolver.named_robot("short").chassis_length == 0.4
    words = ["terrain=ridge", "conditions=slippery", "robot=short", "rewards=calm"]
    evaluated = compose_environment(from_words(words))
    assert (evaluated.sim.friction, evaluated.robot.chassis_length) == (0.5, 0.4)
    file = tmp_path / "conditions" / "slippery.yaml"
    file.write_text(file.read_text().replace("0.5", "0.4"))  # it is read for each composition
    assert compose_environment(from_words(words)).sim.friction == 0.4
    assert find_suite("ridges").scenes[0].words == ("terrain=ridge",)
    for name in presets:
        group, _, own = name.partition("/")
        assert own in {entry.name for entry in entries(group)}
    (tmp_path / "robot" / "short.yaml").rename(tmp_path / "robot" / "nubot.yaml")
    with pytest.raises(ConfigError, match=r"robot: .*nubot\.yaml have the same name; rename one"):
        compose_environment(from_words(["terrain=ridge"]))
