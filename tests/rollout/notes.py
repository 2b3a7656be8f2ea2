"""What tests of trainings listen with, and the processes of a pool."""

from collections.abc import Mapping
from typing import Any

from flipperctl.rollout.children import Child
from flipperctl.rollout.pool import WorkerPool


class Notes:
    """A listener that collects the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def episode(self, row: Mapping[str, Any]) -> None:
        pass

    def validation(self, row: Mapping[str, Any]) -> None:
        pass

    def note(self, text: str) -> None:
        self.notes.append(text)

    def close(self) -> None:
        pass


def process_ids(pool: WorkerPool) -> list[int]:
    """Return the process identifiers of the workers that run on this machine."""
    hosts = [worker._host for worker in pool._workers]
    return [host.pid for host in hosts if isinstance(host, Child)]
