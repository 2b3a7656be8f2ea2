"""The folder for the results of a command: one process, and complete sets of files.

In: the folder, and functions that write files. Out: the command's files, which replace those that
the same command wrote there earlier. The file ``.results.json`` lists each command's files, so that
the user's own are never removed. A second process that wants the same folder fails at once with an
error. The operating system releases the lock when the process dies.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from flipperctl import checkpoint
from flipperctl.config import strict_yaml
from flipperctl.errors import ConfigError, FlipperctlError, OutputError, RunHeldError
from flipperctl.text.files import failure, make_folder, write_json

CONFIG, METRICS, SUMMARY = Path("config.yaml"), Path("metrics.csv"), Path("summary.json")
"""Files of a training run."""
HYDRA = Path(".hydra")


@contextmanager
def hold(directory: Path, name: str = "run", use: str = "being trained") -> Iterator[None]:
    """Hold the lock of an existing directory until the context ends or this process dies.

    ``name`` distinguishes the locks of one directory: a sweep and its only run may share one. The
    file ``.<name>.lock`` lies in the directory and is never removed: if it were removed while
    another process opens it, two processes could hold the lock. ``use`` describes the use of the
    directory in the error's text.

    Raises:
        RunHeldError: another process holds the lock; nothing was written.
        OutputError: the directory cannot be written.
    """
    path = directory / f".{name}.lock"
    lock = FileLock(path)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise RunHeldError(
            f"{directory} is {use} by another process; wait for it, or stop it"
        ) from error
    except OSError as error:
        raise failure(path, error) from error
    try:
        yield
    finally:
        lock.release()


def names(directory: Path, *, numbered: bool) -> Iterator[Path]:
    """Yield the directory and, with ``numbered``, ``…_2``, ``…_3`` and so on beside it."""
    yield directory
    if numbered:
        yield from (directory.with_name(f"{directory.name}_{i}") for i in itertools.count(2))


def holder() -> tuple[str, int]:
    """Return the host and the identifier of this process, for ``is_dead`` in other processes."""
    return socket.gethostname(), os.getpid()


def is_dead(holder: tuple[str, int]) -> bool:
    """Return whether a process of this machine has ended; False if that is unknown."""
    host, process = holder
    if host != socket.gethostname():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # it runs under another user
        pass
    return False


def is_held(directory: Path) -> bool:
    """Return whether a process trains in the directory; False if the folder may only be read."""
    path = directory / ".run.lock"
    if not path.exists():
        return False
    try:
        FileLock(path).acquire(blocking=False).lock.release()
    except Timeout:
        return True
    except OSError:
        pass
    return False


_LIST = ".results.json"
_PART = ".results.part"  # folder in which the files are complete before they take their places


def holds_run(directory: Path) -> bool:
    """Return whether the directory holds a file that a new run would overwrite."""
    if directory.name == HYDRA.name:  # it has a config.yaml of its own
        return False
    files = (directory / name for name in (CONFIG, checkpoint.BEST, checkpoint.LAST))
    return any(file.is_file() and file.stat().st_size > 0 for file in files)


def read_config(path: Path) -> tuple[Any, str]:
    """Return the contents of a ``config.yaml``, or None and the reason that there are none."""
    try:
        return strict_yaml.read(path, path.name), "it is empty"
    except ConfigError as error:
        return None, str(error)


def summary_of(directory: Path) -> dict[str, Any]:
    """Return a run's ``summary.json``; empty while it trains, or if it was killed."""
    try:
        summary = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}


def finished(directory: Path, decision: int) -> dict[str, Any] | None:
    """Return ``summary.json`` if the run finished at this decision, else None."""
    content = summary_of(directory)
    ends = content.get("finished") is True and content.get("decisions") == decision
    return content if ends else None


def unfinished(directory: Path) -> bool:
    """Return whether a run is not trained to its end: stopped, failed or being trained."""
    config, _ = read_config(directory / CONFIG)
    train = config.get("train") if isinstance(config, dict) else None
    planned = train.get("decisions") if isinstance(train, dict) else None
    return isinstance(planned, int) and finished(directory, planned) is None


@dataclass
class ResultFolder:
    """A folder of results that this process holds."""

    path: Path
    command: str
    """The name under which the files are listed."""

    def replace(self, write: Callable[[Path], None], later: Sequence[str] = ()) -> None:
        """Replace the command's earlier files by those that ``write`` leaves in a given folder.

        While ``write`` works, the earlier files stay. Then all are removed before the new ones
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
            earlier = self.files().get(self.command, [])
            # While files change the list names old and new ones, so that a kill leaves none
            # unknown.
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

    def files(self) -> dict[str, list[str]]:
        """Return the names of each command's files; none if the list is damaged."""
        try:
            listed: Any = json.loads((self.path / _LIST).read_text())
            # A name alone: a list that was edited must not lead out of the folder.
            return {key: [Path(name).name for name in names] for key, names in listed.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            return {}

    def _list(self, names: Sequence[str]) -> None:
        mine = set(names)
        others = {c: [n for n in listed if n not in mine] for c, listed in self.files().items()}
        write_json(self.path / _LIST, others | {self.command: sorted(mine)})


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
    # The files of a run are no results, and never replaced.
    run_files = {file.name for file in (CONFIG, METRICS, SUMMARY)}
    lost = sorted(run_files & set(names))
    if lost and path.is_dir() and holds_run(path):
        raise OutputError(
            f"{path} holds a training run, whose {lost[0]} would be replaced; "
            "choose another --output"
        )
    for name in (*names, *summed):
        if (path / name).is_dir():
            raise OutputError(f"{path / name} cannot be written: it is a folder")
    with hold(make_folder(path), "results", use="in use"):
        results = ResultFolder(path, command)
        # A file that no command has listed is the user's.
        listed = {name for files in results.files().values() for name in files}
        for file in sorted(file for name in names for file in path.glob(name)):
            if file.name not in listed:
                raise OutputError(
                    f"{file} is not of an earlier result and would be replaced; move "
                    "it, or choose another --output"
                )
        yield results


@contextmanager
def json_result(folder: Path | None, command: str) -> Iterator[Callable[[Any], None]]:
    """Yield a function that writes a document as ``<command>.json``; it does nothing for None.

    The folder is locked as by ``result_folder``, which lists the errors.
    """
    if folder is None:
        yield lambda document: None
        return
    name = f"{command}.json"
    with result_folder(folder, command, [name]) as results:
        yield lambda document: results.replace(lambda part: write_json(part / name, document))
