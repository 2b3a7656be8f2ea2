"""What every command has: help with examples, and plugins of files."""

import re
from pathlib import Path

import pytest

from flipperctl.cli.inspect import VIEWS
from flipperctl.cli.main import COMMANDS
from tests.cli.call import call


@pytest.mark.parametrize(
    "command",
    [[], *([name] for name in COMMANDS), *(["inspect", name] for name in VIEWS)],
)
def test_help_is_there_with_examples(command: list[str], tmp_path: Path) -> None:
    done = call(*command, "--help", cwd=tmp_path)
    assert done.code == 0
    assert not re.search(r" \.\s", done.out)  # a part in brackets that was read as markup
    if command and command != ["inspect"]:
        assert f"flipperctl {' '.join(command)}" in done.out.split("Examples")[1]


@pytest.mark.parametrize(
    "command",
    [[name] for name in COMMANDS if name != "inspect"] + [["inspect", name] for name in VIEWS],
)
def test_every_subcommand_takes_plugins(command: list[str], tmp_path: Path) -> None:
    needed = {"export": ["onnx", "--checkpoint", "x"], "terrain": ["ridge"]}
    needed |= {"new": ["terrain", "x"], "eval": ["--controller", "level"]}
    needed |= {"transfer": ["--controller", "level"]}
    needed |= {"checkpoint": ["x"], "run": ["x"]}
    arguments = [*command, *needed.get(command[-1], []), "--plugins", "nowhere.py"]
    done = call(*arguments, cwd=tmp_path)
    assert done.code == 2
    assert "nowhere.py does not exist" in done.err
