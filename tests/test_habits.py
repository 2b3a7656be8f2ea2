"""What the project's files say of each other.

Makefile, pre-commit and the forge's workflow run the same checks on every supported Python; the
packages that pyproject.toml lists are those in the folders.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "flipperctl": "flipperctl",
    "flipperctl.configs": "configs",
    "flipperctl_plugins": "plugins",
}


def read(name: str) -> Any:
    return yaml.load((ROOT / name).read_text(), Loader=yaml.BaseLoader)


def static_checks() -> set[str]:
    (recipe,) = re.findall(
        r"^static:\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    return {line.split("$(BIN)/")[1].removesuffix(" .") for line in recipe.splitlines()}


def test_pre_commit_runs_the_static_checks_of_the_makefile() -> None:
    (repository,) = read(".pre-commit-config.yaml")["repos"]
    entries = {hook["entry"].removesuffix(" --force-exclude") for hook in repository["hooks"]}
    assert entries == {f".venv/bin/{check}" for check in static_checks()}
    assert {"mypy", "lint-imports"} < static_checks()


def test_the_long_tests_run_each_night_and_at_no_other_time() -> None:
    nightly = read(".github/workflows/nightly.yml")
    (job,) = nightly["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make long"]
    assert nightly["on"]["schedule"]
    assert (
        "pytest -n 2 --dist loadfile --no-loadscope-reorder -m long\n"
        in (ROOT / "Makefile").read_text()
    )


def test_the_workflow_runs_the_same_script_on_every_supported_python() -> None:
    (job,) = read(".github/workflows/test.yml")["jobs"].values()
    assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
    assert (ROOT / ".ci" / "run").read_text().endswith("\nmake test\n")
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)["project"]
    named = [c.rpartition(" ")[2] for c in project["classifiers"] if "Python :: 3." in c]
    assert job["strategy"]["matrix"]["python"] == named
    assert project["requires-python"] == f">={named[0]}"


def test_every_package_is_listed() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        listed = tomllib.load(file)["tool"]["setuptools"]["packages"]
    found = {"hydra_plugins"}  # a namespace package, which has no __init__.py
    for package, folder in FOLDERS.items():
        for init in (ROOT / folder).rglob("__init__.py"):
            inner = init.parent.relative_to(ROOT / folder).parts
            found.add(".".join([package, *inner]))
    assert sorted(listed) == sorted(found)


def test_the_citation_has_the_version_of_the_package() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        version = tomllib.load(file)["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
