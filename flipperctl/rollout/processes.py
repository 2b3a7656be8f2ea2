"""Actors in worker processes of this machine, for ``train.mode=fast``.

In: requests with their weights. Out: rollouts, in the order of the requests.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, wait
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from safetensors.numpy import load_file, save_file

from flipperctl.rollout.episode import Row
from flipperctl.rollout.pool import WorkerDiedError, WorkerPool
from flipperctl.rollout.values import POLL, Rollout, RolloutRequest, Stop, Weights


class ProcessWorkers:
    """Actors in ``count`` processes; rollouts come in the order of the requests."""

    def __init__(self, count: int, config: dict[str, Any], plugin_paths: list[str]) -> None:
        """``config``: a ``TrainConfig`` as plain data."""
        self.capacity = 2 * count  # each worker plays one request while another waits
        self._pool = WorkerPool(count, _create_actor, (config, plugin_paths))
        self._sent: deque[tuple[RolloutRequest, Future[Rollout]]] = deque()
        # Weights go through files: a process that dies while it receives a long message would block
        # the interpreter's exit (CPython issue 94777, before Python 3.12).
        self._folder = TemporaryDirectory(prefix="flipperctl-", ignore_cleanup_errors=True)
        self._files: dict[int, Path] = {}

    def send(self, request: RolloutRequest) -> None:
        """Queue a request for the next free worker."""
        if request.version not in self._files:
            self._files[request.version] = self._write(f"request{request.version}", request.weights)
        path = self._files[request.version]
        light = replace(request, weights={})
        self._sent.append((request, self._pool.submit(_play, light, path)))

    def take(self, stop: Stop) -> tuple[RolloutRequest, Rollout | None] | None:
        """Wait for the oldest request; return it and its rollout, or None if its worker died.

        Returns None alone, and keeps the request, if ``stop`` returns True first.
        """
        request, future = self._sent[0]
        while not wait([future], POLL).done:
            if stop():
                return None
        self._sent.popleft()
        try:
            return request, future.result()
        except WorkerDiedError:
            return request, None
        finally:
            in_use = {waiting.version for waiting in self.outstanding()}
            for version in self._files.keys() - in_use:
                self._files.pop(version).unlink()

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Future[Row]]:
        """Queue one greedy episode for each seed; they begin in this order."""
        path = self._write("evaluated", weights)
        return [self._pool.submit(_evaluate, path, seed) for seed in seeds]

    def _write(self, name: str, weights: Weights) -> Path:
        path = Path(self._folder.name) / f"{name}.safetensors"
        save_file(dict(weights), path)
        return path

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent but not yet taken, oldest first."""
        return [request for request, _ in self._sent]

    def close(self) -> None:
        """Stop the processes and delete their files."""
        self._pool.close()
        self._folder.cleanup()


_actor: Any = None
"""The actor of this worker process."""


def _create_actor(config: dict[str, Any], plugin_paths: list[str]) -> None:
    global _actor
    from flipperctl.rollout.actor import StartedActor

    _actor = StartedActor(config, plugin_paths)


def _play(request: RolloutRequest, weights: Path) -> Rollout:
    rollout: Rollout = _actor.play(request, load_file(weights))
    return rollout


def _evaluate(weights: Path, seed: int) -> Row:
    row: Row = _actor.evaluate(load_file(weights), seed)
    return row
