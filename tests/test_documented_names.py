"""What the text of README, docs, CONTRIBUTING and SECURITY names in passing exists.

The commands in blocks are run by ``test_documentation.py``. Here are those within sentences, make's
targets, settings, files of the repository, and long checks, of which only the options are read.
"""

import argparse
import re
import runpy
import shlex
import sys
from importlib.util import find_spec
from inspect import signature
from pathlib import Path

import pytest
import typer.main
from stable_baselines3 import DQN, TD3

from benchmarks import __main__ as benchmarks
from benchmarks import settings as benchmark_settings
from docs import generate
from flipperctl.cli.main import app, run_app
from tests.cli.call import COMMANDS

ROOT = Path(__file__).parents[1]
NAMES = ["README.md", "CONTRIBUTING.md", "SECURITY.md"]
PAGES = [*(ROOT / name for name in NAMES), *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {str(page.relative_to(ROOT)): page.read_text() for page in PAGES}
_BLOCK = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
_SETTING = re.compile(r"([a-z_]+(?:\.[a-z_0-9]+)+)(?:=.*)?")
UPGRADE = "docs/upgrade.md"
"""Page that names what existed before."""


def spans() -> list[tuple[str, str]]:
    """Return each page and text between backticks outside of blocks, each once."""
    found = (
        (name, " ".join(span.split()))
        for name, text in TEXTS.items()
        for span in re.findall(r"`([^`]+)`", _BLOCK.sub("", text))
    )
    return list(dict.fromkeys(found))


def inline_commands() -> list[str]:
    """Return the commands of flipperctl within sentences; its name may be left out."""
    texts = dict.fromkeys(span.removeprefix("flipperctl ") for _, span in spans())
    return [text for text in texts if " " in text and text.split()[0] in COMMANDS]


@pytest.mark.parametrize("text", inline_commands())
def test_a_command_within_a_sentence_has_these_options(text: str) -> None:
    command, words = typer.main.get_command(app), shlex.split(text)
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    assert not getattr(command, "commands", {}) or not words or words[0].startswith("-")
    known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)}
    assert {word for word in words if word.startswith("-")} - known - {"--help", "-m"} == set()


def test_every_target_of_make_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    blocks = [block for text in TEXTS.values() for block in _BLOCK.findall(text)]
    code = [span for _, span in spans()] + [line for one in blocks for line in one.splitlines()]
    named = {word for line in code for word in re.findall(r"^make ([a-z-]+)", line)}
    assert {"setup", "check", "test", "docs", "train"} <= named <= targets


def test_every_file_that_is_named_exists() -> None:
    folders = r"\.ci|\.github|benchmarks|configs|docs|examples|flipperctl|plugins|tests"
    paths = [span for _, span in spans() if re.fullmatch(rf"({folders})/[\w./]*", span)]
    assert len(paths) > 10
    assert [path for path in paths if "NAME" not in path and not (ROOT / path).exists()] == []


def test_every_setting_that_is_named_exists() -> None:
    known = set(re.findall(r"^\| `([\w.<>]+)` \|", generate.settings(), re.MULTILINE))
    sections = {path.partition(".")[0] for path in known if "." in path} - {"hydra"}
    missing = set()
    for page, span in spans():
        named = _SETTING.fullmatch(span)
        if page == UPGRADE or not named or named[1].partition(".")[0] not in sections:
            continue
        path = re.sub(r"^rewards\.\w+\.", "rewards.<term>.", named[1])
        path = re.sub(r"^logger\.\w+\.", "logger.<logger>.", path)
        path = path.removeprefix("teacher.") if path.startswith("teacher.controller.") else path
        if path.startswith(("randomise.sim.", "randomise.robot.", "randomise.perception.")):
            path = path.removeprefix("randomise.")  # a setting by its path
        if path.startswith("agent.settings."):  # arguments of DQN or TD3
            arguments = {*signature(DQN).parameters, *signature(TD3).parameters}
            path = "agent.settings" if path.split(".")[2] in arguments else path
        own = re.search(rf"^    {path.rpartition('.')[2]}: ", TEXTS[page], re.MULTILINE)
        if path not in known and not own:  # a field of the plugin that the page writes
            missing.add((page, path))
    assert missing == set()


def words_after(pattern: str) -> list[str]:
    """Return what follows ``python -m``, in blocks and within sentences."""
    text = "\n".join([*TEXTS.values(), *(span for _, span in spans())])
    return list(dict.fromkeys(re.findall(rf"^python -m {pattern}$", text, re.MULTILINE)))


@pytest.mark.parametrize("words", words_after("benchmarks (.*)"))
def test_the_words_of_a_benchmark_are_read(words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[str] = []
    monkeypatch.setattr(
        benchmark_settings, "run_measures", lambda *_: called.append(words) or {"measures": {}}
    )
    run_app(benchmarks.app, [*shlex.split(words), "--json"], "benchmarks")
    assert called == [words]


class _ParsedError(Exception):
    pass


@pytest.mark.parametrize("command", words_after(r"(tests\.long\..*)"))
def test_the_options_of_a_long_check_are_read(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, *options = shlex.split(command)
    assert find_spec(module) is not None
    if not options:
        return
    parse = argparse.ArgumentParser.parse_args

    def parsed(parser: argparse.ArgumentParser, *arguments: object) -> None:
        parse(parser, *arguments)
        raise _ParsedError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parsed)
    monkeypatch.setattr(sys, "argv", [module, *options])
    monkeypatch.delitem(sys.modules, module, raising=False)  # else running it again warns
    with pytest.raises(_ParsedError):
        runpy.run_module(module, run_name="__main__")
