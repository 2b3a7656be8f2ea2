"""The ``flipperctl`` command: its subcommands, exit codes and error messages."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from importlib import import_module

import typer
from typer.exceptions import TyperException

from flipperctl.cli import output
from flipperctl.cli.streams import log_to_stderr, plain_streams
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError

DEBUG = "FLIPPERCTL_DEBUG"
COMMANDS = ("train", "eval", "transfer", "export", "inspect", "new", "bench")
"""Modules beside this one, each with a subcommand; help lists them in this order."""

# Absent flags default to False. Otherwise Typer would import pydantic to validate an absent
# flag, which costs every subcommand's help 65 ms.
_ABSENT = {"help": False, "install_completion": False, "show_completion": False}

app = typer.Typer(
    name="flipperctl",
    help="Train, evaluate, export and explain flipper policies of tracked rescue robots.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"default_map": {**_ABSENT, "inspect": {"help": False}}},
)


@app.callback()
def root(version: bool = typer.Option(False, "--version", help="Print the version.")) -> None:
    """Train, evaluate, export and explain flipper policies of tracked rescue robots."""


for _name in COMMANDS:
    import_module(f"flipperctl.cli.{_name}").add_to(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code (0, 1, 2 or 130)."""
    plain_streams()
    if os.environ.get(DEBUG) == "1":
        log_to_stderr()
    code = _run(list(sys.argv[1:] if arguments is None else arguments))
    error = output.flush()
    if error is not None and code == 0:
        code = FlipperctlError.exit_code
        if reason := output.failure_reason(error):
            code = _report_output_failure(reason)
    sys.exit(code)


def _run(arguments: list[str]) -> int:
    debug = os.environ.get(DEBUG) == "1"
    try:
        if arguments == ["--version"]:
            from flipperctl import __version__

            print(f"flipperctl {__version__}")
            return 0
        command = typer.main.get_command(app)
        code = command.main(args=arguments, prog_name="flipperctl", standalone_mode=False)
        if code == InterruptedRunError.exit_code:  # Typer's answer to Ctrl-C, without a word
            raise KeyboardInterrupt
        return code if isinstance(code, int) else 0
    except FlipperctlError as error:
        if debug:
            raise
        _print_error(str(error))
        return error.exit_code
    except TyperException as error:
        if debug:
            raise
        if words := error.format_message().rstrip(
            "."
        ):  # empty without arguments, where the help is shown
            _print_error(f"{words}; see flipperctl --help")
        return RequestError.exit_code
    except (typer.Abort, KeyboardInterrupt):
        _print_error("interrupted")
        return InterruptedRunError.exit_code
    except BrokenPipeError:
        return FlipperctlError.exit_code  # the reader closed the pipe
    except SystemExit:
        raise  # Hydra's own options exit so; a plugin's is already a PluginError
    except BaseException as error:
        if isinstance(error, Exception) and (reason := output.failure_reason(error)):
            return _report_output_failure(reason)
        if debug:
            raise
        _print_error(
            f"{type(error).__name__}: {error} (an error in flipperctl; {DEBUG}=1 shows where)"
        )
        return 1


def _report_output_failure(reason: str) -> int:
    _print_error(f"standard output cannot be written: {reason}")
    return FlipperctlError.exit_code


def _print_error(text: str) -> None:
    with contextlib.suppress(OSError):  # standard error cannot be written either
        print(f"error: {text}", file=sys.stderr)


if __name__ == "__main__":
    main()
