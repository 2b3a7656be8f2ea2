"""What ``wandb`` and ``trackio`` share: a library with ``init``, ``log`` and ``finish``.

In: the rows of a training. Out: their numbers in the tracker, with decisions as steps. The library
works in a thread of its own, so that a slow one does not hold up the training.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from queue import SimpleQueue
from threading import Thread
from typing import Any, Protocol
from uuid import uuid4

from flipperctl.api import RunInfo, scalars

_STATE = "run.json"
"""File in the logger's folder: id of the run in the tracker, and the last decision of each kind of
row that it has."""


class TrackedRun(Protocol):
    """A run of a tracker."""

    def log(self, values: dict[str, float], step: int) -> object:
        """Record values by name."""

    def finish(self) -> object:
        """Send what is left."""


Begin = Callable[[str], TrackedRun]
"""Function of a run's id that begins the run in the tracker, or goes on with it if it is there."""


def require(package: str) -> None:
    """Check that a tracker's package is installed.

    Raises:
        ImportError: it is not.
    """
    if find_spec(package) is None:
        raise ImportError(
            f"the package {package} is not installed; run pip install 'flipperctl[{package}]'"
        )


class Tracker:
    """Records a training in a tracker; what fails in its thread is raised at the next call."""

    def __init__(self, begin: Begin, run: RunInfo, patience: float) -> None:
        """``patience``: longest time that ``close`` waits for the tracker [s]."""
        self._begin, self._patience = begin, patience
        self._state = run.folder / _STATE
        self._id, self._logged = uuid4().hex[:12], {"episode": -1, "validation": -1}
        if run.resume_at is not None:
            self._restore()
        run.folder.mkdir(parents=True, exist_ok=True)
        self._rows: SimpleQueue[tuple[str, int, dict[str, float]] | None] = SimpleQueue()
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, name="tracker", daemon=True)
        self._thread.start()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record the row's numbers."""
        self._add("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record the row's numbers."""
        self._add("validation", row)

    def note(self, text: str) -> None:
        """Ignore notes; a tracker would send them as alerts."""

    def close(self) -> None:
        """Wait until the tracker has finished.

        Raises:
            TimeoutError: it has not within ``patience``.
        """
        self._rows.put(None)
        self._thread.join(self._patience)
        if self._thread.is_alive():
            raise TimeoutError(f"it has not finished within {self._patience:g} s")
        self._raise_error()

    def _add(self, kind: str, row: Mapping[str, Any]) -> None:
        self._raise_error()
        self._rows.put((kind, row["decision"], scalars(kind, row)))

    def _raise_error(self) -> None:
        if isinstance(self._error, Exception):
            raise self._error
        if self._error is not None:  # SystemExit must not end the training
            raise RuntimeError(repr(self._error)) from self._error

    def _work(self) -> None:
        try:
            self._save()  # before the run begins there, so that no killed training loses its id
            tracked = self._begin(self._id)
            while (row := self._rows.get()) is not None:
                kind, decision, values = row
                if decision > self._logged[kind]:  # a resumed run repeats the rest exactly
                    tracked.log(values, step=decision)
                    self._logged[kind] = decision
                    if kind == "validation":
                        self._save()
            tracked.finish()
            self._save()
        except BaseException as error:  # noqa: BLE001  # raised in the training's thread
            self._error = error

    def _restore(self) -> None:
        """Read the state of the run's earlier start; without a readable one, a new run begins."""
        try:
            found = json.loads(self._state.read_text())
            run_id, logged = str(found["id"]), {k: int(found[k]) for k in self._logged}
        except (OSError, ValueError, TypeError, KeyError):
            return
        self._id, self._logged = run_id, logged

    def _save(self) -> None:
        part = self._state.with_suffix(".part")
        part.write_text(json.dumps({"id": self._id, **self._logged}))
        part.replace(self._state)
