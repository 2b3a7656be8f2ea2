"""Makefile, pre-commit and the forge's workflow run the same checks on every supported Python."""

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]


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
