"""What tests of trainings listen with, and the processes of a pool."""

from collections.abc import Mapping
from typing import Any

from flipperctl.errors import WriteError
from flipperctl.rollout.pool import ProcessHost, WorkerPool


class Notes:
    """A listener that keeps what it is given, and fails in the methods that are named."""

    def __init__(self, *failing: str) -> None:
        self.failing, self.closed = failing, 0
        self.notes: list[str] = []
        self.rows: list[Mapping[str, Any]] = []

    def _fail(self, method: str) -> None:
        if method in self.failing:
            raise WriteError(f"{method} failed")

    def episode(self, row: Mapping[str, Any]) -> None:
        self.rows.append(row)
        self._fail("episode")

    def validation(self, row: Mapping[str, Any]) -> None:
        self.rows.append(row)
        self._fail("validation")

    def note(self, text: str) -> None:
        self.notes.append(text)
        self._fail("note")

    def close(self) -> None:
        self.closed += 1
        self._fail("close")


def process_ids(pool: WorkerPool) -> list[int]:
    """Return the process identifiers of the workers that run on this machine."""
    return [host.pid for host in pool._hosts.values() if isinstance(host, ProcessHost)]
