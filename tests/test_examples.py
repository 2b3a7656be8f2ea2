"""The example packages, installed in a fresh virtual environment as a plugin author would."""

import json
import shutil
import sysconfig
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

from flipperctl.api import registry
from flipperctl.testing import checks
from tests.cli.call import call
from tests.environment import Environment
from tests.plugins.test_contract import AT_NIGHT

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
PACKAGES = {
    "trunk": "terrain",
    "stretcher": "reward",
    "near_far": "network",
    "postures": "controller",
}

INSTALLED = ("trunk", "postures")

Flipperctl = Callable[..., str]


def package(name: str) -> Path:
    return EXAMPLES / f"flipperctl_{name}"


@pytest.fixture(scope="module")
def flipperctl(tmp_path_factory: pytest.TempPathFactory) -> Flipperctl:
    """Return the command line of an environment with two packages on top of this one."""
    folder = tmp_path_factory.mktemp("fresh")
    environment = Environment.create(folder / "venv", folder)
    # All dependencies and flipperctl come from this environment, so that no network is needed.
    here = sysconfig.get_path("purelib")
    (environment.site / "here.pth").write_text(f"import site; site.addsitedir({here!r})\n")
    copies = [str(shutil.copytree(package(name), folder / name)) for name in INSTALLED]
    environment.install("--no-deps", "--no-build-isolation", *copies)
    python = environment.script("python")
    return lambda *arguments: environment.run(python, "-m", "flipperctl", *arguments)


@pytest.mark.long
def test_an_installed_package_passes_the_conformance_suite(flipperctl: Flipperctl) -> None:
    rows = json.loads(flipperctl("inspect", "plugins", "trunk", "--check", "--json"))
    assert {(row["kind"], row["name"]) for row in rows} == {("terrain", "trunk")}
    assert all(row["ok"] and not row["skipped"] for row in rows)


@pytest.mark.long
def test_one_packages_controller_is_evaluated_on_anothers_terrain(flipperctl: Flipperctl) -> None:
    evaluate = ["eval", "--controller", "postures", "terrain=trunk", "--episodes", "2", "--json"]
    (scene,) = json.loads(flipperctl(*evaluate))["scenes"]
    assert (scene["terrain"], scene["success_rate"]) == ("trunk", 1.0)


@pytest.mark.parametrize("name", PACKAGES)
@pytest.mark.usefixtures("registry")
def test_each_package_passes_its_own_test(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(package(name) / "src")
    import_module(f"flipperctl_{name}")
    for check in checks(registry[PACKAGES[name], name]):
        if not AT_NIGHT.match(str(check)):  # then the suite runs in the installed package
            check()


@pytest.mark.parametrize("name", ["low", "swift"])
@pytest.mark.usefixtures("registry")
def test_each_reward_in_a_file_passes_the_conformance_suite(name: str, tmp_path: Path) -> None:
    example = str(EXAMPLES / f"{name}.py")
    done = call("inspect", "plugins", name, "--check", "--plugins", example, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    rows = json.loads(done.out)
    assert {(row["kind"], row["name"]) for row in rows} == {("reward", name)}
    assert all(row["ok"] and not row["skipped"] for row in rows)
