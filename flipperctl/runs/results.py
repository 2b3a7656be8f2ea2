"""The folder for the results of a command: one writer, and complete sets of files.

In: the folder, and functions that write files. Out: the command's files, which replace those that
the same command wrote there earlier. The file ``.results.json`` lists each command's files, so that
the user's own are never removed.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from flipperctl.errors import FlipperctlError, OutputError
from flipperctl.files import failure, make_folder, write_json
from flipperctl.runs import folder as run_folder
from flipperctl.runs.lock import hold

_LIST = ".results.json"
_PART = ".results.part"
"""Folder in which the files are complete before they take their places."""


class ResultFolder:
    """A folder of results that this process holds."""

    def __init__(self, path: Path, command: str) -> None:
        """``command`` is the name under which the files are listed."""
        self.path = path
        self._command = command

    def replace(self, write: Callable[[Path], None], later: Sequence[str] = ()) -> None:
        """Replace the command's earlier files by those that ``write`` leaves in a given folder.

        While ``write`` works, the earlier files stay; then all are removed before the new ones
        take their places, so that files of two evaluations never lie side by side, even after a
        kill. ``later`` names files that the command will write into ``path`` by itself.

        Raises:
            OutputError: a file cannot be written.
            WriteError: writing failed half way; the earlier files are untouched.
        """
        part = self.path / _PART
        try:
            shutil.rmtree(part, ignore_errors=True)  # of a process that was killed
            part.mkdir()
            write(part)
            new = sorted(file.name for file in part.iterdir())
            earlier = self._files().get(self._command, [])
            self._list([*earlier, *new, *later])
            for name in earlier:
                (self.path / name).unlink(missing_ok=True)
            for name in new:
                (part / name).replace(self.path / name)
            self._list([*new, *later])
        except FlipperctlError as error:  # which names the file where it was to be completed
            raise type(error)(str(error).replace(str(part), str(self.path))) from error
        except OSError as error:
            raise failure(self.path, error) from error
        finally:
            shutil.rmtree(part, ignore_errors=True)

    def require_own(self, names: Sequence[str]) -> None:
        """Refuse to replace files that no command has written here; ``names`` may be patterns.

        Folders of version 0.2 have no list.

        Raises:
            OutputError: there is such a file.
        """
        listed = {name for own in self._files().values() for name in own}
        if not listed and _is_summary(self.path / run_folder.SUMMARY):
            return
        for file in sorted(file for name in names for file in self.path.glob(name)):
            if file.name not in listed:
                raise OutputError(
                    f"{file} is not of an earlier result and would be replaced; move "
                    "it, or choose another --output"
                )

    def _files(self) -> dict[str, list[str]]:
        """Return the names of each command's files; none if the list is damaged."""
        try:
            listed: Any = json.loads((self.path / _LIST).read_text())
            # A name alone: a list that was edited must not lead out of the folder.
            return {key: [Path(name).name for name in names] for key, names in listed.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _list(self, names: Sequence[str]) -> None:
        mine = set(names)
        others = {c: [n for n in listed if n not in mine] for c, listed in self._files().items()}
        write_json(self.path / _LIST, others | {self._command: sorted(mine)})


def _is_summary(file: Path) -> bool:
    """Return whether a file is the summary of an evaluation."""
    try:
        document: Any = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(document, dict) and {"controller", "scenes"} <= set(document)


@contextmanager
def result_folder(
    path: Path, command: str, names: Sequence[str], summed: Sequence[str] = ()
) -> Iterator[ResultFolder]:
    """Create and lock the folder until the context ends or this process dies.

    ``names`` are the files that the command will write, or patterns of their names; ``summed``
    those that only sum up others of the folder.

    Raises:
        OutputError: the folder cannot be written, or would lose a file that is no result.
        RunHeldError: another process is writing results into it.
    """
    own = {file.name for file in (run_folder.CONFIG, run_folder.METRICS, run_folder.SUMMARY)}
    lost = sorted(own & set(names))
    if lost and path.is_dir() and run_folder.holds_run(path):
        raise OutputError(
            f"{path} holds a training run, whose {lost[0]} would be replaced; "
            "choose another --output"
        )
    for name in (*names, *summed):
        if (path / name).is_dir():
            raise OutputError(f"{path / name} cannot be written: it is a folder")
    with hold(make_folder(path), "results", use="in use"):
        found = ResultFolder(path, command)
        found.require_own(names)
        yield found


@contextmanager
def json_result(folder: Path | None, command: str) -> Iterator[Callable[[Any], None]]:
    """Yield a function that writes a document as ``<command>.json``; it does nothing for None.

    The folder is locked as by ``result_folder``, which lists the errors.
    """
    if folder is None:
        yield lambda document: None
        return
    name = f"{command}.json"
    with result_folder(folder, command, [name]) as held:
        yield lambda document: held.replace(lambda part: write_json(part / name, document))
