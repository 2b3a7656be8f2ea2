"""The pages of ``docs/`` build without a warning, and the reference leaves nothing out."""

import importlib
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from sphinx.util.inventory import InventoryFile

import flipperctl
from docs import generate
from flipperctl.api import Outcome, registry
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig
from tests.cli.call import GROUPS, SUBCOMMANDS

ROOT = Path(__file__).parents[1]


def names(module: str) -> set[str]:
    return {f"{module}.{name}" for name in importlib.import_module(module).__all__}


@pytest.mark.slow  # it begins early: Sphinx takes long
@pytest.mark.long
def test_every_public_name_and_setting_and_command_is_shown(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet"]
    done = subprocess.run(
        [*build, "-d", tmp_path / "doctrees", ROOT / "docs", tmp_path / "html"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    inventory = InventoryFile.loads((tmp_path / "html/objects.inv").read_bytes(), uri="").data
    known = {name for kind, found in inventory.items() if kind.startswith("py:") for name in found}
    for module in generate.MODULES:
        assert names(module) - known == set()
    assert "flipperctl.env.flipper_env.FlipperEnv.step" in known
    reference = tmp_path / "html" / "reference"
    shown = "".join(page.read_text() for page in (reference / "settings").glob("*.html"))
    ours = [cls for cls in registry.values() if cls.__module__.startswith("flipperctl")]
    assert all(f".{field}<" in shown for cls in ours for field in cls.model_fields)
    shown = (reference / "commands.html").read_text()
    assert all(f"flipperctl-{'-'.join(words)}" in shown for words in SUBCOMMANDS)


def test_every_name_command_and_section_has_its_entry() -> None:
    text = generate.api()
    for module in generate.MODULES:
        assert {name for name in names(module) if f":: {name}\n" not in text} == set()
    for entry in re.split(r"(?m)^(?=\.\. py:data:)", text)[1:]:
        assert re.search(r"\n\n   \S", entry.partition("\n.. auto")[0]), entry
    parts = re.findall(r"(?m)^## `flipperctl ?([^`]*)`\n", generate.commands())
    assert set(parts) == {"", *GROUPS, *map(" ".join, SUBCOMMANDS)}
    page = generate.settings()
    fields = {*TrainConfig.model_fields, *EvalConfig.model_fields}
    assert {name for name in fields if f"`{name}" not in page} == set()


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
