"""What every command has: help, plugins of files, options of one value, files that it keeps."""

import re
from pathlib import Path

import pytest
import typer
import typer.main
from rich.cells import cell_len

from flipperctl.cli.main import app
from tests.cli.call import GROUPS, SUBCOMMANDS, call, refused


@pytest.mark.parametrize("command", [[], *([group] for group in GROUPS), *SUBCOMMANDS])
def test_help_is_there_with_examples(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    done = call(*command, "--help", cwd=tmp_path)
    assert done.code == 0
    assert not re.search(r"\w [.,;]\s", done.out)  # a part in brackets that was read as markup
    assert max(map(cell_len, done.out.splitlines())) <= 80
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
    needed = {"export": ["onnx", "x"], "terrain": ["ridge"]}
    needed |= {"new": ["terrain", "x"], "eval": ["--controller", "level"]}
    needed |= {"checkpoint": ["x"], "run": ["x"], "check": ["x"], "self-test": ["x"]}
    needed |= {"identify": ["x"]}
    needed |= {"shadow": ["x.onnx", "x"], "ground": ["x", "--output", "x.xyz"]}
    needed |= {"robot drive": ["x", "--outcome", "reached"]}
    arguments = needed.get(" ".join(command), needed.get(command[-1], []))
    arguments = [*command, *arguments, "--plugins", "nowhere.py"]
    done = call(*arguments, cwd=tmp_path)
    assert done.code == 2
    assert "nowhere.py does not exist" in done.err


def test_an_option_given_twice_is_refused(tmp_path: Path) -> None:
    for command in SUBCOMMANDS:
        found = typer.main.get_command(app)
        for name in command:
            found = found.commands[name]
        options = [p for p in found.params if p.param_type_name == "option"]
        single = [p.opts[0] for p in options if not (p.is_flag or p.multiple)]
        for option in single[-1:]:
            error = refused(*command, option, "1", f"{option}=2", cwd=tmp_path)
            assert f"{option} is given twice: 1 and 2; one is allowed" in error
    twice = ["--baseline", "okada", "--baseline", "level"]
    assert "--baseline okada,level" in refused("eval", "mpc", *twice, cwd=tmp_path)


EVAL = ("eval", "--controller", "okada", "terrain=flat", "--episodes", "1")


@pytest.mark.parametrize(
    ("words", "suffix"),
    [
        ((*EVAL, "--film"), ".gif"),
        ((*EVAL, "--record"), ".safetensors"),
        (("replay", "failure.json", "--film"), ".gif"),
        (("train", "terrain=flat", "--film"), ".gif"),
        (("export", "onnx", "generalist", "--output"), ".onnx"),
        (("export", "mjcf", "terrain=flat", "--output"), ".xml"),
        (("export", "urdf", "terrain=flat", "--output"), ".urdf"),
        (("robot", "shadow", "policy.onnx", "bag", "--output"), ".jsonl"),
        (("robot", "ground", "bag", "--output"), ".xyz"),
        (("card", "generalist", "--output"), ".md"),
        (("inspect", "terrain", "flat", "--output"), ".png"),
        (("inspect", "run", "run", "--output"), ".svg"),
        (("plot", "results", "--output"), ".pdf"),
        (("compare", "results", "--output"), ".tex"),
        (("robot", "check", "bag", "--output"), ".gif"),
    ],
    ids=lambda value: None if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_file_of_the_users_is_kept(words: tuple[str, ...], suffix: str, tmp_path: Path) -> None:
    (tmp_path / f"mine{suffix}").write_text("of the user")
    kept = refused(*words, f"mine{suffix}", cwd=tmp_path)
    assert f"mine{suffix} exists and is kept" in kept
    assert (tmp_path / f"mine{suffix}").read_text() == "of the user"


def test_a_training_keeps_the_results_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("of an evaluation")
    done = call("train", "terrain=flat", "experiment=quick", "hydra.run.dir=.", cwd=tmp_path)
    assert done.code == 2
    assert "summary.json is not of a run" in done.err
    assert (tmp_path / "summary.json").read_text() == "of an evaluation"


def test_an_option_of_two_numbers_takes_negative_ones(tmp_path: Path) -> None:
    (tmp_path / "span.py").write_text(
        """
from typing import Annotated
import typer
from flipperctl.api import command

@command("span")
def span(over: Annotated[tuple[float, float], typer.Option()] = (0.0, 1.0)) -> None:
    "Print two numbers."
    print(over)
"""
    )
    words = "span", "--plugins", "span.py", "--over", "3", "-5"
    assert call(*words, cwd=tmp_path).out == "(3.0, -5.0)\n"
    assert "--over is given twice" in refused(*words, "--over", "1", "2", cwd=tmp_path)
