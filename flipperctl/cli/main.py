"""The ``flipperctl`` command: its subcommands, exit codes and error messages."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext

import typer
from typer.exceptions import TyperException

from flipperctl.cli import evaluate, inspect, lookup, plot, reward, train, write
from flipperctl.cli.command import App
from flipperctl.errors import InterruptedRunError, RequestError
from flipperctl.process import entry
from flipperctl.terminal.streams import (
    begin_notices,
    log_to_stderr,
    replace_missing_characters,
    reserved_stdout,
)

app = App(
    order=(
        *("train", "eval", "tune", "map", "replay", "compare", "plot", "watch", "demo", "drive"),
        *("card", "report", "export", "list", "explain", "new", "bench", "inspect", "robot"),
    ),
    name="flipperctl",
    help="Train, evaluate, export and explain flipper policies of tracked rescue robots.",
    no_args_is_help=True,
    context_settings={
        "default_map": {"help": False, "install_completion": False, "show_completion": False}
    },
)


@app.callback()
def root(version: bool = typer.Option(False, "--version", help="Print the version.")) -> None:
    """Train, evaluate, export and explain flipper policies of tracked rescue robots."""


app.add("train", train.train)
app.add("eval", evaluate.evaluate)
app.add("map", evaluate.map_success)
app.add("replay", evaluate.replay)
app.add("compare", evaluate.compare)
app.add("plot", plot.plot)
app.add("card", write.card)
app.add("report", write.report)
app.add("list", lookup.list_names)
app.add("explain", lookup.explain)
app.add("new", write.new)
_views = app.group("inspect", "Look at plugins, terrains, rewards, files, runs and settings.")
_views.add("plugins", inspect.plugins)
_views.add("terrain", inspect.terrain)
_views.add("reward", reward.reward)
_views.add("checkpoint", inspect.checkpoint)
_views.add("run", inspect.run)
_views.add("config", inspect.config)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code (0, 1, 2 or 130)."""
    entry.run(lambda: run(arguments))


def run(words: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; ``words``: None for those that were typed."""
    arguments = list(sys.argv[1:] if words is None else words)
    replace_missing_characters()
    if os.environ.get(entry.DEBUG) == "1":
        log_to_stderr()
    begin_notices()
    if arguments == ["--version"]:
        from flipperctl import __version__

        print(f"flipperctl {__version__}")
        return 0
    with reserved_stdout() if "--json" in arguments else nullcontext():
        return run_app(app, arguments, "flipperctl")


def run_app(app: typer.Typer, arguments: list[str], name: str) -> int:
    """Run an application, which its help calls ``name``; return its exit code."""
    try:
        command = typer.main.get_command(app)
        code = command.main(args=arguments, prog_name=name, standalone_mode=False)
    except TyperException as error:
        # Without arguments, the help is shown and the text is empty.
        if words := " ".join(error.format_message().split()).rstrip("."):
            context = getattr(error, "ctx", None)
            path = context.command_path if context else name
            raise RequestError(f"{words}; see {path} --help") from error
        return RequestError.exit_code
    except typer.Abort as error:
        if isinstance(error.__cause__, EOFError):  # Typer takes it for the end of what is typed
            raise error.__cause__ from None
        raise KeyboardInterrupt from error
    except BaseException as error:  # SystemExit too, with which a plugin must not end the command
        guard = sys.modules.get("flipperctl.plugging.guard")  # without it, no plugin was loaded
        if guard is not None and (named := guard.attributed(error)):
            raise named from error
        raise
    if code == InterruptedRunError.exit_code:  # returned by Typer after Ctrl-C
        raise KeyboardInterrupt
    return code if isinstance(code, int) else 0
