"""What every command has: help with examples, and plugins of files."""

import re
from pathlib import Path

import pytest
import typer.main
from rich.cells import cell_len

from flipperctl.cli.main import app
from tests.cli.call import GROUPS, SUBCOMMANDS, call


@pytest.mark.parametrize("width", [80, 100])
@pytest.mark.parametrize("command", [[], *([group] for group in GROUPS), *SUBCOMMANDS])
def test_help_is_there_with_examples_at_any_width(
    command: list[str], width: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    done = call(*command, "--help", cwd=tmp_path)
    assert done.code == 0
    assert not re.search(r" \.\s", done.out)  # a part in brackets that was read as markup
    assert max(map(cell_len, done.out.splitlines())) <= width
    found = typer.main.get_command(app)
    for name in command:
        found = found.commands[name]
    words = [str(found.help), *(str(getattr(param, "help", "")) for param in found.params)]
    assert done.out.count("…") <= "".join(words).count("…")  # nothing is cut
    text, _, examples = str(found.help).partition("[bold]Examples[/]")
    assert not re.search(r"\S\n\S", text)  # paragraphs fill the width
    if command in SUBCOMMANDS:
        assert f"flipperctl {' '.join(command)}" in examples
    assert [line for line in examples.splitlines() if line.strip() not in done.out] == []


@pytest.mark.parametrize("command", SUBCOMMANDS)
def test_every_subcommand_takes_plugins(command: list[str], tmp_path: Path) -> None:
    needed = {"export": ["onnx", "--checkpoint", "x"], "terrain": ["ridge"]}
    needed |= {"new": ["terrain", "x"], "eval": ["--controller", "level"]}
    needed |= {"checkpoint": ["x"], "run": ["x"], "check": ["x"], "self-test": ["x"]}
    needed |= {"shadow": ["x.onnx", "x"], "ground": ["x", "--output", "x.xyz"]}
    arguments = [*command, *needed.get(command[-1], []), "--plugins", "nowhere.py"]
    done = call(*arguments, cwd=tmp_path)
    assert done.code == 2
    assert "nowhere.py does not exist" in done.err
