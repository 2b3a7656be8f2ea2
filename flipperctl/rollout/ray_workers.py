"""Actors on a Ray cluster; rollouts come as soon as they are ready.

When a worker or a node is lost, the episodes that it was playing are lost, and Ray starts the actor
again on a node with a free CPU. The weights of a version are sent once for all workers.
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

_REQUESTS_PER_WORKER = 2
"""Requests of one worker: it plays one while the other waits."""


class RayWorkers:
    """Actors on a cluster, or on a local cluster if ``collector.address`` is not set."""

    def __init__(
        self, settings: RayCollector, config: dict[str, Any], plugin_paths: list[str]
    ) -> None:
        """``config``: the container of a ``TrainConfig``.

        Raises:
            MissingExtraError: Ray is not installed.
            ConfigError: there is no cluster at the address.
        """
        ray = _import_ray()
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
        self.capacity = _REQUESTS_PER_WORKER * settings.workers
        self._sent: dict[Any, tuple[RolloutRequest, int]] = {}
        """Request and worker by the reference of the rollout."""
        self._shared: tuple[Weights | None, Any] = (None, None)

    def send(self, request: RolloutRequest) -> None:
        """Send a request to the actor with the fewest pending requests."""
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
        """Return the result of a call; None if its actor or its result was lost."""
        errors = self._ray.exceptions
        try:
            return self._ray.get(reference, timeout=self._settings.patience)
        except errors.RayTaskError as error:
            if isinstance(error.cause, FlipperctlError):  # without the text of Ray
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
        """Return the requests that were sent and not yet taken, oldest first."""
        return [request for request, _ in self._sent.values()]

    def close(self) -> None:
        """Stop the actors, and the cluster if it was started here."""
        for actor in self._actors:
            self._ray.kill(actor)
        if self._owned:
            self._ray.shutdown()


_QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}


def start_local(cpus: int) -> None:
    """Start a cluster for this process alone, unless it is connected to one already.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    ray = _import_ray()
    if not ray.is_initialized():  # "local": do not join a cluster of this machine
        ray.init(address="local", num_cpus=cpus, include_dashboard=False, **_QUIET)


def _import_ray() -> Any:
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
        _check_reachable(address)
        _import_ray().init(address=address, **_QUIET)
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError(
            f"collector.address: no Ray cluster answers at {address!r}: "
            f"{' '.join(str(error).split())[:200]}"
        ) from error


def _check_reachable(address: str) -> None:
    """Raise ``OSError`` unless the address answers; Ray itself would try for minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if port.isdigit():
        socket.create_connection((host, int(port)), timeout=10.0).close()
