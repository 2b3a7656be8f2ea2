"""The pages of ``docs/`` build without a warning, and the reference leaves nothing out."""

import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
from sphinx.util.inventory import InventoryFile

import flipperctl
from docs import generate
from flipperctl.api import Outcome, Plugin, Settings, registry
from flipperctl.cli.main import app
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig
from tests.cli.call import COMMANDS, GROUPS, SUBCOMMANDS

ROOT = Path(__file__).parents[1]
BASES = {"CommonSettings", "_ShortForms", "RobotGeometry", "EnvConfig", "TrainConfig", "EvalConfig"}
"""Classes of settings that others inherit, or that hold the sections."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    done = subprocess.run(
        [*build, "-d", folder / "doctrees", ROOT / "docs", folder / "html"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder / "html"


@pytest.fixture(scope="module")
def tables() -> dict[str, dict[str, list[str]]]:
    """Heading of the settings' page → setting → its other cells."""
    found: dict[str, dict[str, list[str]]] = {}
    for line in generate.settings().splitlines():
        if line.startswith("#"):
            rows = found.setdefault(line.lstrip("# "), {})
        elif line.startswith("| `"):
            name, *cells = re.split(r"(?<!\\)\|", line.strip("|"))
            rows[name.strip(" `").rpartition(".")[2]] = [cell.strip() for cell in cells]
    return found


def sections(cls: type[Settings] = Settings) -> Iterator[type[Settings]]:
    for inner in cls.__subclasses__():
        if inner.__module__.startswith("flipperctl.") and not issubclass(inner, Plugin):
            yield from sections(inner)
            inherited = any(issubclass(plugin, inner) for plugin in registry.values())
            if inner.__name__ not in BASES and not inherited:
                yield inner


def names(module: str) -> set[str]:
    return {f"{module}.{name}" for name in importlib.import_module(module).__all__}


def test_every_public_name_has_its_directive() -> None:
    text = generate.api()
    for module in generate.MODULES:
        assert {name for name in names(module) if f":: {name}\n" not in text} == set()


@pytest.mark.slow  # it begins early: Sphinx takes long
@pytest.mark.long
def test_every_public_name_and_setting_and_command_is_shown(site: Path) -> None:
    inventory = InventoryFile.loads((site / "objects.inv").read_bytes(), uri="").data
    known = {name for kind, found in inventory.items() if kind.startswith("py:") for name in found}
    for module in generate.MODULES:
        assert names(module) - known == set()
    assert "flipperctl.env.flipper_env.FlipperEnv.step" in known
    shown = (site / "reference" / "settings.html").read_text()
    ours = [cls for cls in registry.values() if cls.__module__.startswith("flipperctl")]
    assert all(f".{field}<" in shown for cls in ours for field in cls.model_fields)
    shown = (site / "reference" / "commands.html").read_text()
    assert all(f"flipperctl-{command}" in shown for command in COMMANDS)


def test_every_entry_says_what_it_is() -> None:
    for entry in re.split(r"(?m)^(?=\.\. py:data:)", generate.api())[1:]:
        assert re.search(r"\n\n   \S", entry.partition("\n.. auto")[0]), entry


def test_every_setting_of_a_plugin_has_its_entry(tables: dict[str, dict[str, list[str]]]) -> None:
    keys = {"reward": "rewards"}
    for (kind, name), cls in registry.items():
        if not cls.__module__.startswith("flipperctl"):
            continue  # of another test
        rows = tables[f"`{keys.get(kind, kind)}`: `{name}`"]
        assert set(rows) == set(cls.model_fields)
        assert all(cells[-1] for cells in rows.values())


def test_every_setting_of_a_section_has_its_entry(tables: dict[str, dict[str, list[str]]]) -> None:
    found = {cls: f"`{name}`" for name, cls in generate.SECTIONS.items()}
    for cls in sections():
        assert set(tables[found[cls]]) == set(cls.model_fields) - {"name"}
        assert all(cells[-1] for cells in tables[found[cls]].values())
    headings = {re.sub(r"\W.*", "", heading.lstrip("`")) for heading in tables}
    assert {*TrainConfig.model_fields, *EvalConfig.model_fields} <= {
        *headings, *tables["Top level"],
    }  # fmt: skip


def test_every_command_and_option_has_its_entry() -> None:
    text = generate.commands()
    parts = dict(re.findall(r"(?ms)^## `flipperctl ?([^`]*)`\n(.*?)(?=^## |\Z)", text))
    assert set(parts) == {"", *GROUPS, *map(" ".join, SUBCOMMANDS)}
    for path, part in parts.items():
        command = typer.main.get_command(app)
        for word in path.split():
            command = command.commands[word]
        options = {option for p in command.params for option in p.opts if option.startswith("-")}
        assert {option for option in options - {"--help"} if option not in part} == set()


def test_the_page_of_the_environment_names_all_that_it_takes_and_returns() -> None:
    page = generate.fill((ROOT / "docs" / "environment.md").read_text())
    env = flipperctl.environment(terrain="flat")
    env.reset(seed=1)
    info: dict[str, Any] = {}
    while "outcome" not in info:
        *_, info = env.step(4)
    numbers = (re.sub("^(reward|drawn)_.*", r"\1_<", key) for key in info["metrics"])
    names = {*info, *numbers, *EnvConfig.model_fields, *Outcome}
    assert {name for name in names if f"`{name}" not in page} == set()
    assert (
        "| 0 … 14 | `h_1` … `h_15` | mean terrain height, up positive | m | L | -100 | 100 |"
        in page
    )
    assert "| 32 | `theta_R` | pitch, nose up positive | rad | L | -3.142 | 3.142 |" in page
    assert "| 5 | hold | up |" in page
