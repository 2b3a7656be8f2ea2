"""How plugins are found, and what a user reads when one cannot be."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from flipperctl import api, plugins
from flipperctl.api.plugin import registered_names
from flipperctl.config import resolver
from flipperctl.config.identity import foreign_sources
from flipperctl.errors import PluginError

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


def test_the_built_ins_come_through_the_entry_point() -> None:
    assert {"flat", "step", "stair", "paper_step", "paper_stair"} <= set(
        registered_names("terrain")
    )
    assert {"flipper", "pitch", "end"} <= set(registered_names("reward"))


def test_a_script_may_import_a_built_in_before_the_plugins_are_loaded() -> None:
    script = "import flipperctl_plugins; from flipperctl import plugins; plugins.load()"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_file_is_loaded_once(tmp_path: Path) -> None:
    file = write(tmp_path / "mine.py")
    plugins.load([file])
    plugins.load([file])
    assert resolver.create("terrain", "ridge", "terrain").generate(None).end == 0.6


def test_a_file_that_was_changed_needs_a_new_process(tmp_path: Path) -> None:
    """Workers, which begin later, would run the new code beside the old one here."""
    file = write(tmp_path / "mine.py")
    plugins.load([file])
    file.write_text(file.read_text() + "# changed\n")
    with pytest.raises(PluginError, match=r"mine\.py has changed since it was loaded here; start"):
        plugins.load([file])


def test_a_folder_gives_all_its_files_but_private_ones(tmp_path: Path) -> None:
    write(tmp_path / "one.py", "one")
    write(tmp_path / "two.py", "two")
    write(tmp_path / "_private.py", "three")
    plugins.load([tmp_path])
    assert {"one", "two"} <= set(registered_names("terrain"))
    assert "three" not in registered_names("terrain")


def test_the_variable_names_files_and_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write(tmp_path / "one.py", "one")
    folder = tmp_path / "folder"
    folder.mkdir()
    write(folder / "two.py", "two")
    monkeypatch.setenv("FLIPPERCTL_PLUGINS", f"{file}{os.pathsep}{folder}")
    plugins.load()
    assert {"one", "two"} <= set(registered_names("terrain"))


@pytest.mark.usefixtures("registry")
def test_the_paths_are_remembered_for_workers_and_the_environment_is_not_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    before = dict(os.environ)
    plugins.load(["mine.py"])
    assert plugins.configured_paths() == [str(tmp_path / "mine.py")]
    assert dict(os.environ) == before


def test_nothing_is_loaded_from_the_working_directory_unasked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    plugins.load()
    assert "ridge" not in registered_names("terrain")


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("1 / 0", "ZeroDivisionError"),
        ("import json; json.loads('{')", "JSONDecodeError"),  # raised inside a library's file
        ("height: = 0.2", "invalid syntax"),
    ],
)
def test_a_plugin_that_does_not_import_names_file_and_line(
    tmp_path: Path, body: str, text: str
) -> None:
    file = write(tmp_path / "broken.py", body=body)
    with pytest.raises(PluginError) as error:
        plugins.load([file])
    assert f"{file}:2: " in str(error.value)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plugin_that_fails_half_way_leaves_nothing_behind(tmp_path: Path) -> None:
    file = write(tmp_path / "broken.py")
    file.write_text(file.read_text() + "\n1 / 0\n")
    with pytest.raises(PluginError):
        plugins.load([file])
    assert "ridge" not in registered_names("terrain")
    assert "stair" in registered_names("terrain")
    write(file)  # mended, it loads
    plugins.load([file])
    assert "ridge" in registered_names("terrain")


def test_a_file_that_registers_nothing_is_an_error(tmp_path: Path) -> None:
    file = tmp_path / "empty.py"
    file.write_text("GRAVITY = 9.81\n")
    with pytest.raises(PluginError, match="registers nothing; decorate a class"):
        plugins.load([file])


def test_a_name_taken_twice_names_both(tmp_path: Path) -> None:
    one, two = write(tmp_path / "one.py"), write(tmp_path / "two.py")
    plugins.load([one])
    with pytest.raises(PluginError) as error:
        plugins.load([two])
    text = str(error.value)
    assert "two terrain plugins are called 'ridge'" in text
    assert re.search(r"flipperctl_user_\w+\.one\.", text)
    assert re.search(r"flipperctl_user_\w+\.two\.", text)
    assert f"{two}:3: " in text


def test_a_built_in_name_is_not_taken_silently(tmp_path: Path) -> None:
    with pytest.raises(
        PluginError, match=r"'stair': flipperctl_plugins\.terrains\.stair\.Stair"
    ) as e:
        plugins.load([write(tmp_path / "mine.py", "stair")])
    assert "choose another name" in str(e.value)  # a built-in cannot be left out


def test_the_same_name_in_another_family_is_free(tmp_path: Path) -> None:
    plugins.load([write(tmp_path / "mine.py", "pitch")])
    assert api.registry["terrain", "pitch"] is not api.registry["reward", "pitch"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("gone.py", "does not exist"),
        ("notes.txt", r"is not a \.py file"),
        ("empty", r"no \.py file"),
    ],
)
def test_a_path_without_plugins_says_why(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / "notes.txt").touch()
    (tmp_path / "empty").mkdir()
    with pytest.raises(PluginError, match=f"{name} .*{text}"):
        plugins.load([tmp_path / name])


def test_a_bad_name_and_a_wrong_family_are_errors(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="plugin name 'My Ridge'"):
        plugins.load([write(tmp_path / "name.py", "My Ridge")])
    wrong = write(tmp_path / "family.py")
    wrong.write_text(wrong.read_text().replace("terrain", "reward"))
    with pytest.raises(PluginError, match="Ridge is not a RewardTerm"):
        plugins.load([wrong])


@pytest.mark.parametrize(
    "kind",
    ["terrain", "reward", "network", "controller", "engine", "sensor", "measure", "logger"],
)
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
    with pytest.raises(PluginError, match=r"heights\.py has changed since it was loaded here"):
        plugins.load([tmp_path])


def test_a_file_that_no_neighbour_imports_must_register_something(tmp_path: Path) -> None:
    write(tmp_path / "a.py", "aridge")
    (tmp_path / "heights.py").write_text("HEIGHT = 0.2\n")
    with pytest.raises(PluginError, match=r"heights\.py registers nothing"):
        plugins.load([tmp_path])


def test_an_absolute_import_of_a_neighbour_says_how_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "heights.py").write_text("HEIGHT = 0.2\n")
    file = write(tmp_path / "a.py", body="from heights import HEIGHT")
    with pytest.raises(PluginError, match=r"beside it: write from \.heights import"):
        plugins.load([file])
