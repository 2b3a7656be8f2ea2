"""The checks of a subcommand: what its help says, and how it refuses a wrong request.

In: the plugin of a function. Out: a refusal that names what is missing.
"""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from typing import get_args

from flipperctl.api import Subcommand
from flipperctl.plugging import plugins
from flipperctl.testing.check import NotChecked, of, require

_UNKNOWN = "--no-such-option"


@of("command", "help")
def help_is_complete(command: Subcommand) -> None:
    """Check that each argument and option has a help text."""
    parameters = inspect.signature(command.run, eval_str=True).parameters
    for name, parameter in parameters.items():
        if getattr(parameter.annotation, "__name__", "") == "Context":  # typer's own
            continue
        texts = [getattr(info, "help", None) for info in get_args(parameter.annotation)[1:]]
        require(
            any(texts),
            f"has a parameter {name!r} without help; write {name}: Annotated[…, "
            'typer.Option(help="…")], or typer.Argument',
        )


@of("command", "example")
def an_example_is_shown(command: Subcommand) -> None:
    """Check that the docstring has a command that can be typed."""
    typed = f"flipperctl {command.plugin_name}"
    require(
        typed in (inspect.getdoc(command) or ""),
        f"shows no example; end its docstring with [bold]Examples[/] and a line {typed} …",
    )


@of("command", "bad input")
def a_wrong_request_is_refused(command: Subcommand) -> None:
    """Check that an unknown option leaves with exit code 2 and a line that names it."""
    # As a user meets it: in a process of its own
    words = [sys.executable, "-m", "flipperctl", *command.plugin_name.split(), _UNKNOWN]
    paths = os.pathsep.join(plugins.configured_paths())
    done = subprocess.run(  # noqa: S603  # of this package
        words, env={**os.environ, plugins.VARIABLE: paths}, capture_output=True, text=True
    )
    if "No such command" in done.stderr:
        raise NotChecked("another process does not find it; define it in a file or a module")
    require(
        done.returncode == 2 and f"error: no such option: {_UNKNOWN}" in done.stderr,
        f"leaves with {done.returncode} where {_UNKNOWN} is given, and says {done.stderr[-200:]!r}",
    )
