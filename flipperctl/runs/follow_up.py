"""Follow-up commands that are printed for the user, with the ``--plugins`` of this command.

In: words of a command, and the paths of ``--plugins``. Out: a line for the shell. Installed
plugins and those of ``FLIPPERCTL_PLUGINS`` need no option.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path

from flipperctl.errors import InterruptedRunError

_plugin_paths: list[str] = []


def remember_plugins(paths: Iterable[str | Path] | None) -> None:
    """Remember the paths of ``--plugins`` as they were typed, in place of earlier ones."""
    _plugin_paths[:] = map(str, paths or ())


def plugin_paths() -> list[str]:
    """Return the remembered paths, for a worker process that prints commands too."""
    return list(_plugin_paths)


def command(*words: str | Path) -> str:
    """Return ``flipperctl`` with these words and the remembered plugins, quoted for the shell.

    A path inside the working directory is printed relative to it.
    """
    typed = [_short(word) if isinstance(word, Path) else word for word in words]
    plugins = [part for path in _plugin_paths for part in ("--plugins", path)]
    return shlex.join(["flipperctl", *typed, *plugins])


def interrupted_run(run: Path) -> InterruptedRunError:
    """Return the error for a training that Ctrl-C stopped, with the command that resumes it."""
    return InterruptedRunError(f"interrupted. Resume with: {command('train', '--resume', run)}")


def sweep_command(folder: Path) -> str:
    """Return the command that continues the sweep in ``folder``, which this process runs."""
    words = [word for word in sys.argv[1:] if word != "--multirun"]
    if not any(word.startswith("hydra.sweep.dir=") for word in words):
        short = os.path.relpath(folder) if folder.is_relative_to(Path.cwd()) else str(folder)
        plain = re.fullmatch(r"[\w./-]+", short) is not None
        from flipperctl.config.words import literal_override  # only where it is needed

        key = "hydra.sweep.dir"
        words.append(f"{key}={short}" if plain else literal_override(key, short))
    return command("train", "-m", *words)


def quote_path(path: Path) -> str:
    """Return a path relative to the working directory, if it is inside, quoted for the shell."""
    return shlex.quote(_short(path))


def _short(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
