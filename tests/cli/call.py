"""The command line, called in this process as a user would call it."""

import contextlib
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer.main

from flipperctl import api
from flipperctl.cli.main import app, main
from flipperctl.plugging import plugins

_PROGRAM: Any = typer.main.get_command(app)
COMMANDS: dict[str, Any] = _PROGRAM.commands
GROUPS = {name: list(one.commands) for name, one in COMMANDS.items() if hasattr(one, "commands")}
SUBCOMMANDS = [
    *([name] for name in COMMANDS if name not in GROUPS),
    *([group, view] for group, views in GROUPS.items() for view in views),
]
RUN = {
    "train.workers": 2,  # forked from one server; a lone worker imports torch for each training
    "train.decisions": 150,
    "train.validation_episodes": 2,
    "train.regret_episodes": 0,  # tests/cli/test_rewards.py has its own
    "agent.learning_starts": 60,
    "agent.epsilon_decisions": 100,
}
"""A training of a second, with workers."""
EXACT = {**RUN, "train.mode": "exact"}
"""The same in this process alone, which computes a third less."""


@dataclass(frozen=True)
class Done:
    """The exit code and output of a command."""

    code: int
    out: str
    err: str


def call(*arguments: str, cwd: Path) -> Done:
    """Run ``flipperctl`` in ``cwd``; plugins that it loads are unloaded afterwards.

    No line of its output is broken, unless COLUMNS says so.
    """
    known, loaded, given = dict(api.registry), set(plugins._loaded), list(plugins._given)
    environment = dict(os.environ)
    os.environ.pop(plugins.VARIABLE, None)
    os.environ.setdefault("COLUMNS", "10000")
    plugins._given.clear()
    out, err = io.StringIO(), io.StringIO()
    try:
        with (
            contextlib.chdir(cwd),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            try:
                main(arguments)
            except SystemExit as left:
                return Done(int(left.code or 0), out.getvalue(), err.getvalue())
        raise AssertionError("main did not leave")
    finally:
        api.registry.clear()
        api.registry.update(known)
        plugins._loaded.clear()
        plugins._loaded.update(loaded)
        plugins._given[:] = given
        os.environ.clear()
        os.environ.update(environment)


def refused(*arguments: str, cwd: Path, code: int = 2) -> str:
    """The error's text, after the checks that hold for every error."""
    before = _files(cwd)
    done = call(*arguments, cwd=cwd)
    assert done.code == code, done.err
    assert done.out == ""
    assert done.err.startswith("error: ")
    assert "Traceback" not in done.err
    assert len(done.err.strip().splitlines()) <= 2, done.err
    assert _files(cwd) == before
    return done.err


def _files(folder: Path) -> list[Path]:
    """What lies in the folder; Python keeps compiled plugins unless the shell says otherwise."""
    return sorted(path for path in folder.rglob("*") if "__pycache__" not in path.parts)
