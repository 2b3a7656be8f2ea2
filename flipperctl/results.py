"""The folder for the results of a command: one process, and complete sets of files.

In: the folder, and functions that write files. Out: the command's files, which replace those that
the same command wrote there earlier. The file ``.results.json`` lists each command's files, so that
the user's own are never removed. A second process that wants the same folder fails at once with an
error that names the holder. The operating system releases the lock when the process dies; on a file
system without locks, a lock file names the process.
"""

from __future__ import annotations

import errno
import itertools
import json
import os
import shutil
import socket
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from filelock import BaseFileLock, FileLock, SoftFileLock, Timeout

from flipperctl import checkpoint
from flipperctl.config import strict_yaml
from flipperctl.errors import ConfigError, FlipperctlError, OutputError, RunHeldError
from flipperctl.files import failure, make_folder, write_json

CONFIG, METRICS, SUMMARY = Path("config.yaml"), Path("metrics.csv"), Path("summary.json")
"""Files of a training run."""
HYDRA = Path(".hydra")
_UNSUPPORTED = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP}
_PATIENCE = 1.0  # time to wait for the holder's note before the holder counts as unknown [s]


@contextmanager
def hold(directory: Path, name: str = "run", use: str = "being trained") -> Iterator[None]:
    """Hold the lock of an existing directory until the context ends or this process dies.

    ``name`` distinguishes the locks of one directory: a sweep and its only run may share one. The
    files ``.<name>.lock`` and ``.<name>.lock.json`` (a note on the holder) lie in the directory.
    The first is never removed: if it were removed while another process opens it, two processes
    could hold the lock. ``use`` describes the use of the directory in the error's text.

    Raises:
        RunHeldError: another process holds the lock; nothing was written.
        OutputError: the directory cannot be written.
    """
    path = directory / f".{name}.lock"
    note = directory / f".{name}.lock.json"
    try:
        lock = _acquire(path)
    except Timeout as error:
        raise RunHeldError(_held_text(directory, path, note, use)) from error
    except OSError as error:
        raise failure(path, error) from error
    try:
        write_json(note, holder())
        yield
    finally:
        note.unlink(missing_ok=True)
        lock.release()


def names(directory: Path, *, numbered: bool) -> Iterator[Path]:
    """Yield the directory and, with ``numbered``, ``…_2``, ``…_3`` and so on beside it."""
    yield directory
    if numbered:
        yield from (directory.with_name(f"{directory.name}_{i}") for i in itertools.count(2))


def _acquire(path: Path) -> BaseFileLock:
    """Acquire a lock of the operating system, or a lock file where the file system has none."""
    with warnings.catch_warnings():
        # The library warns when it uses a lock file instead; the user need not act on that.
        warnings.simplefilter("ignore", UserWarning)
        try:
            lock: BaseFileLock = FileLock(path)
            lock.acquire(blocking=False)
        except OSError as error:  # a network file system without its lock service
            if isinstance(error, Timeout) or error.errno not in _UNSUPPORTED:
                raise
            lock = SoftFileLock(path.with_suffix(".softlock"))  # it replaces that of a dead process
            lock.acquire(blocking=False)
    return lock


def holder() -> dict[str, Any]:
    """Return the identifier and host of this process, and the time, for other processes."""
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    return {"pid": os.getpid(), "host": socket.gethostname(), "since": since}


def is_held(directory: Path) -> bool:
    """Return whether a process works in the directory: one of here or of another machine.

    A note alone may be that of a dead process.
    """
    path = directory / ".run.lock"
    if not path.exists() and not path.with_suffix(".softlock").exists():
        return False
    try:
        _acquire(path).release()
    except (Timeout, OSError):  # a folder that may only be read has the note alone
        note = _read_note(directory / ".run.lock.json")
        return note is not None and not is_dead(note)
    return False


def _held_text(directory: Path, path: Path, note: Path, use: str) -> str:
    """Return the error's text for a held folder.

    The holder writes its note after it has the lock, so that the note may be missing or, after a
    crash, be that of a dead process.
    """
    deadline = time.monotonic() + _PATIENCE
    while (found := _read_note(note)) is None or is_dead(found):
        if time.monotonic() >= deadline:
            return f"{directory} is {use} by another process; wait for it, or stop it"
        time.sleep(0.02)
    soft = path.with_suffix(".softlock")
    advice = f" (if it is gone, delete {soft})" if soft.exists() else ""
    return (
        f"{directory} is {use} by process {found['pid']} on {found['host']} since "
        f"{found['since']}; wait for it, or stop it{advice}"
    )


def _read_note(note: Path) -> dict[str, Any] | None:
    """Return the note that the file has now; None if it is missing or damaged."""
    try:
        found = json.loads(note.read_text())
        return dict(found) if {"pid", "host", "since"} <= found.keys() else None
    except (OSError, ValueError, AttributeError):  # missing, damaged or not a mapping
        return None


def is_dead(holder: dict[str, Any]) -> bool:
    """Return whether a process of this machine has ended; False if that is unknown."""
    if holder["host"] != socket.gethostname() or os.name != "posix":
        return False
    try:
        os.kill(int(holder["pid"]), 0)
    except (ProcessLookupError, TypeError, ValueError, OverflowError):
        return True
    except PermissionError:  # it runs under another user
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


def finished(directory: Path, decision: int) -> dict[str, Any] | None:
    """Return ``summary.json`` if the run finished at this decision, else None."""
    try:
        summary = json.loads((directory / SUMMARY).read_text())
    except (OSError, ValueError):
        return None
    found: dict[str, Any] = summary if isinstance(summary, dict) else {}
    ends = found.get("finished") is True and found.get("decisions") == decision
    return found if ends else None


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
            earlier = self.files().get(self.command, [])
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
    own = {file.name for file in (CONFIG, METRICS, SUMMARY)}
    lost = sorted(own & set(names))
    if lost and path.is_dir() and holds_run(path):
        raise OutputError(
            f"{path} holds a training run, whose {lost[0]} would be replaced; "
            "choose another --output"
        )
    for name in (*names, *summed):
        if (path / name).is_dir():
            raise OutputError(f"{path / name} cannot be written: it is a folder")
    with hold(make_folder(path), "results", use="in use"):
        found = ResultFolder(path, command)
        listed = {name for own in found.files().values() for name in own}
        for file in sorted(file for name in names for file in path.glob(name)):
            if file.name not in listed:
                raise OutputError(
                    f"{file} is not of an earlier result and would be replaced; move "
                    "it, or choose another --output"
                )
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
