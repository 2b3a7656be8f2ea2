"""Actors on a Ray cluster; rollouts come as they are ready.

A worker or node that is lost costs the episodes that it was playing: Ray starts the actor again
where there is room. The weights go out once per version, whatever the number of workers.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from flipperctl.config import RayCollector
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError
from flipperctl.rollout.values import PendingEvaluation, Rollout, RolloutRequest, Weights

_DEPTH = 2
"""Requests a worker: one is waiting while the other is played."""


class RayWorkers:
    """Actors on a cluster, or on a local one if no address is given."""

    def __init__(
        self, settings: RayCollector, config: dict[str, Any], plugin_paths: list[str]
    ) -> None:
        """``config``: the container of a ``TrainConfig``.

        Raises:
            MissingExtraError: Ray is not installed.
            ConfigError: there is no cluster at the address.
        """
        ray = _imported()
        self._ray = ray
        self._settings = settings
        self._owned = not ray.is_initialized()
        if self._owned:
            _connect(settings)
        from flipperctl.rollout.actor import StartedActor

        remote: Any = ray.remote(StartedActor)
        actor = remote.options(num_cpus=1, max_restarts=-1)
        self._actors: list[Any] = [
            actor.remote(config, plugin_paths) for _ in range(settings.workers)
        ]
        self.count = settings.workers
        self.capacity = _DEPTH * settings.workers
        self._sent: dict[
            Any, tuple[RolloutRequest, int]
        ] = {}  # by the reference of what will be played
        self._shared: tuple[Weights | None, Any] = (None, None)

    def send(self, request: RolloutRequest) -> None:
        """Send a request to the actor that has the least to do."""
        load = [0] * len(self._actors)
        for _, worker in self._sent.values():
            load[worker] += 1
        worker = load.index(min(load))
        if self._shared[0] is not request.weights:
            self._shared = (request.weights, self._ray.put(dict(request.weights)))
        slim = replace(request, weights={})
        reference = self._actors[worker].play.remote(slim, self._shared[1])
        self._sent[reference] = (request, worker)

    def take(self) -> tuple[RolloutRequest, Rollout | None]:
        """Wait for the first rollout that is ready, and return it with its request."""
        ready, _ = self._ray.wait(list(self._sent), timeout=self._settings.patience)
        if not ready:
            raise FlipperctlError(
                f"no Ray worker has played an episode for {self._settings.patience:g} s "
                "(collector.patience); has the cluster as many free CPUs as collector.workers "
                f"({self._settings.workers})?"
            )
        request, _ = self._sent.pop(ready[0])
        return request, self._get(ready[0])

    def evaluate(self, weights: Weights, parts: Sequence[Sequence[int]]) -> list[PendingEvaluation]:
        """Send each actor its part of the seeds."""
        shared = self._ray.put(dict(weights))
        pairs = zip(self._actors, parts, strict=True)
        references = [actor.evaluate.remote(shared, part) for actor, part in pairs]
        return [partial(self._get, reference) for reference in references]

    def _get(self, reference: Any) -> Any:
        """What a call returned; None if its actor, or what it returned, was lost."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(reference, timeout=self._settings.patience)
        except errors.RayTaskError as error:
            if isinstance(error.cause, FlipperctlError):  # as it was raised, without Ray's own text
                raise error.cause from None
            raise error.as_instanceof_cause() from None
        except (
            errors.RayActorError,
            errors.ObjectLostError,
            errors.WorkerCrashedError,
            errors.GetTimeoutError,
        ):
            return None

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent and not taken."""
        return [request for request, _ in self._sent.values()]

    def close(self) -> None:
        """Stop the actors, and the cluster if it was started here."""
        for actor in self._actors:
            self._ray.kill(actor)
        if self._owned:
            self._ray.shutdown()


_QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}


def start_local(cpus: int) -> None:
    """Start a cluster of this process' own, unless there is one.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    ray = _imported()
    if not ray.is_initialized():  # "local": whatever else runs on this machine is not ours
        ray.init(address="local", num_cpus=cpus, include_dashboard=False, **_QUIET)


def _imported() -> Any:
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("collector=ray needs Ray: pip install flipperctl[ray]") from error
    return ray


def _connect(settings: RayCollector) -> None:
    address = settings.address
    if address is None:
        start_local(settings.workers)
        return
    try:
        _knock(address)
        _imported().init(address=address, **_QUIET)
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError(
            f"collector.address: no Ray cluster answers at {address!r}: "
            f"{' '.join(str(error).split())[:200]}"
        ) from error


def _knock(address: str) -> None:
    """Ray itself tries for minutes before it says that nobody is there."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if port.isdigit():
        socket.create_connection((host, int(port)), timeout=10.0).close()
