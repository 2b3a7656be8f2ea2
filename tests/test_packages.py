"""The list of packages in pyproject.toml is what lies in the folders."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "flipperctl": "flipperctl",
    "flipperctl.configs": "configs",
    "flipperctl_plugins": "plugins",
}


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
