"""Actors on a Ray cluster; rollouts come as soon as they are ready.

The cluster is started here, or joined at an address. An actor gets requests once it has a CPU and
has started; the others wait for a CPU. When a worker or a node is lost, its running episodes are
lost, and Ray restarts the actor on a node with a free CPU. The weights of a version are sent once
for all workers.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

from flipperctl.config import RayCollector
from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError
from flipperctl.rollout.children import import_path
from flipperctl.rollout.episode import Row
from flipperctl.rollout.pool import WorkerDiedError
from flipperctl.rollout.values import POLL, Rollout, RolloutRequest, Stop, Weights

QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
"""Settings of ``ray.init`` for a process that shows its own messages."""
_PATIENCE = 10.0
"""Longest wait for a host's answer [s]; Ray itself would try for minutes."""


def import_ray() -> Any:
    """Return the module ``ray``.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("collector=ray needs Ray: pip install flipperctl[ray]") from error
    return ray


def start_local(cpus: int) -> None:
    """Start a cluster for this process alone, unless it is already connected to one.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    ray = import_ray()
    if not ray.is_initialized():  # "local": do not join a cluster of this machine
        with _kept_sigterm():
            ray.init(
                address="local",
                num_cpus=cpus,
                include_dashboard=False,
                job_config=_job_config(),
                **QUIET,
            )


def join(address: str | None, key: str, **settings: Any) -> None:
    """Connect to a running cluster; ``settings`` are passed on to ``ray.init``.

    ``key``: configuration path of the address, for the errors. Without an address, Ray joins a
    cluster on this machine, or starts one.

    Raises:
        MissingExtraError: Ray is not installed.
        ConfigError: no cluster answers, it asks for a token, or it refuses a setting.
    """
    ray = import_ray()
    if "runtime_env" not in settings:  # which may have an import path of its own
        settings = {"job_config": _job_config(), **settings}
    try:
        _check_reachable(address)
        with _kept_sigterm():
            ray.init(address=address, **settings)
    except (OSError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        if _is_refused_token(error):
            raise ConfigError(
                f"{key}: the Ray cluster at {address!r} asks for its token; set RAY_AUTH_MODE=token"
                " and give the token in RAY_AUTH_TOKEN, or its file in RAY_AUTH_TOKEN_PATH"
            ) from error
        reason = " ".join(str(error).split())[:200]
        if isinstance(error, ValueError):  # raised before connecting, about the settings
            raise ConfigError(f"{key}: Ray cannot use {address!r}: {reason}") from error
        raise ConfigError(f"{key}: no Ray cluster answers at {address!r}: {reason}") from error


def _job_config() -> Any:
    """Return the settings by which workers import from where this process does.

    Ray itself would let them import from the working directory first, except those of a job that it
    takes for a client's.
    """
    from ray.job_config import JobConfig

    # A worker inserts one folder after the other at the head of its own.
    return JobConfig(_client_job=True, _py_driver_sys_path=import_path()[::-1])


def is_connected() -> bool:
    """Return whether this process is connected to a cluster; Ray is not imported for it."""
    ray = sys.modules.get("ray")
    return ray is not None and bool(ray.is_initialized())


def shut_down() -> None:
    """Close the connection, and stop a cluster that this process has started."""
    if is_connected():
        import_ray().shutdown()


def cpus() -> tuple[int, int]:
    """Return the numbers of free CPUs and of all CPUs of the cluster."""
    ray = import_ray()
    free, total = ray.available_resources(), ray.cluster_resources()
    return int(free.get("CPU", 0)), int(total.get("CPU", 0))


def _is_refused_token(error: BaseException) -> bool:
    """Return whether Ray failed for lack of a token, which only a cause's text says."""
    found: BaseException | None = error
    while found is not None:
        if "AuthenticationError" in f"{type(found).__name__} {found}":
            return True
        found = found.__cause__
    return False


def _check_reachable(address: str | None) -> None:
    """Raise an error unless a cluster answers at ``host:port`` and accepts the token."""
    host, _, port = (address or "").rpartition("://")[2].rpartition(":")
    if not port.isdigit():
        return
    socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    if "://" not in str(address):  # ``ray.init`` would repeat a refused token for 20 s
        from ray import _raylet

        client: Any = _raylet
        client.GcsClient(address=address)


@contextlib.contextmanager
def _kept_sigterm() -> Iterator[None]:
    """Keep this process's SIGTERM handler, which ``ray.init`` replaces by an exit."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # not in the main thread
            signal.signal(signal.SIGTERM, before)


_REQUESTS_PER_WORKER = 2
"""Requests per worker: one is played while the other waits."""
_REPORT_AFTER = 10.0
"""Time after which workers that still wait for a CPU are reported [s]."""


class RayWorkers:
    """Actors on a cluster, or on a local cluster if ``collector.address`` is not set."""

    def __init__(
        self,
        settings: RayCollector,
        config: dict[str, Any],
        plugin_paths: list[str],
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Create the actors; do not wait until they have started.

        ``config``: a ``TrainConfig`` as plain data. ``report`` is called with sentences about the
        workers for the user.

        Raises:
            MissingExtraError: Ray is not installed.
            ConfigError: no cluster answers at the address, or it asks for a token.
        """
        ray = import_ray()
        self._ray, self._settings, self._report = ray, settings, report
        self._owned = not ray.is_initialized()
        if self._owned and settings.address is None:
            start_local(settings.workers)
        elif self._owned:
            join(settings.address, "collector.address", **QUIET)
        from flipperctl.rollout.actor import StartedActor

        remote: Any = ray.remote(StartedActor)
        actor = remote.options(num_cpus=1, max_restarts=-1)
        self._started: list[Any] = []
        self._starting: dict[Any, Any] = {}
        """Actors by the references that become ready once they have started."""
        for _ in range(settings.workers):
            self._await_start(actor.remote(config, plugin_paths, str(Path.cwd())))
        self._changed_at, self._reported = time.monotonic(), 0
        self._waited = 0.0
        """Time of waiting since the last rollout [s]."""
        self._queue: deque[RolloutRequest] = deque()
        self._sent: dict[Any, tuple[RolloutRequest, Any]] = {}
        """Requests and actors by the references of their rollouts."""
        self._shared: tuple[Weights | None, Any] = (None, None)
        self._closed = False

    @property
    def capacity(self) -> int:
        """Number of requests that keeps all started workers busy."""
        return _REQUESTS_PER_WORKER * max(1, len(self._started))

    def send(self, request: RolloutRequest) -> None:
        """Queue a request for a worker that has started."""
        self._queue.append(request)
        self._dispatch()

    def take(self, stop: Stop) -> tuple[RolloutRequest, Rollout | None] | None:
        """Wait for the first rollout that is ready; return it with its request.

        The rollout is None if its worker was lost. Returns None alone if ``stop`` returns True
        before.

        Raises:
            FlipperctlError: no rollout has come for ``collector.patience``, or a worker cannot
                start.
        """
        while not stop():
            self._collect_started()
            self._dispatch()
            begun = time.monotonic()
            ready, _ = self._ray.wait([*self._sent, *self._starting], timeout=POLL)
            self._waited += time.monotonic() - begun
            if self._waited > self._settings.patience:
                raise FlipperctlError(self._timeout_text())
            for reference in ready:
                if reference in self._sent:
                    return self._taken(reference)
        return None

    def _taken(self, reference: Any) -> tuple[RolloutRequest, Rollout | None]:
        request, actor = self._sent.pop(reference)
        try:
            rollout: Rollout = self._get(reference, actor)
        except WorkerDiedError:
            return request, None
        self._waited = 0.0
        return request, rollout

    def _await_start(self, actor: Any) -> None:
        self._starting[actor.__ray_ready__.remote()] = actor

    def _collect_started(self) -> None:
        """Let the actors that have started take requests; report those that get no CPU."""
        waiting = list(self._starting)
        ready = self._ray.wait(waiting, num_returns=len(waiting), timeout=0)[0] if waiting else []
        for reference in ready:
            actor = self._starting.pop(reference)
            try:
                self._ray.get(reference)
            except self._ray.exceptions.ActorUnavailableError:  # lost again; Ray restarts it
                self._await_start(actor)
                continue
            except self._ray.exceptions.RayActorError as error:
                last = str(error).strip().splitlines()[-1]
                raise FlipperctlError(f"a Ray worker cannot start: {last}") from error
            self._started.append(actor)
            self._changed_at = time.monotonic()
        if self._starting and time.monotonic() > self._changed_at + _REPORT_AFTER:
            self._changed_at = time.monotonic()
            self._report_waiting()

    def _report_waiting(self) -> None:
        """Report once how many workers have no CPU, if none is free."""
        count, (free, total) = len(self._starting), cpus()
        if free or count == self._reported:
            return
        self._reported = count
        text = (
            f"{count} of {self._settings.workers} Ray workers (collector.workers) have no CPU: "
            f"none of the cluster's {total} is free. "
        )
        if self._started:
            text += f"The run continues with {len(self._started)}; others join when a CPU is free"
        else:
            text += (
                f"The run waits up to {self._settings.patience:g} s (collector.patience) for one"
            )
        self._report(text)

    def _dispatch(self) -> None:
        """Send queued requests to the started actors with the fewest pending ones.

        Each gets as many as keep it busy; the rest waits for others, which may start later.
        """
        if not self._started:
            return
        load = {id(actor): 0 for actor in self._started}
        for _, actor in self._sent.values():
            load[id(actor)] = load.get(id(actor), 0) + 1
        while self._queue:
            actor = min(self._started, key=lambda one: load[id(one)])
            if load[id(actor)] >= _REQUESTS_PER_WORKER:
                return
            request = self._queue.popleft()
            if self._shared[0] is not request.weights:
                self._shared = (request.weights, self._ray.put(dict(request.weights)))
            load[id(actor)] += 1
            light = replace(request, weights={})
            self._sent[actor.play.remote(light, self._shared[1])] = (request, actor)

    def _timeout_text(self) -> str:
        patience = f"{self._settings.patience:g} s (collector.patience)"
        free, total = cpus()
        if self._started:
            return f"no Ray worker has played an episode for {patience}"
        return (
            f"no Ray worker got a CPU and started within {patience}: {free} of the cluster's "
            f"{total} CPUs are free; wait for other jobs to end, or add machines"
        )

    def evaluate(self, weights: Weights, seeds: Sequence[int]) -> list[Future[Row]]:
        """Let the started actors play one greedy episode for each seed, begun in this order."""
        shared = self._ray.put(dict(weights))
        calls: list[tuple[int, Future[Row]]] = [(seed, Future()) for seed in seeds]
        arguments = (shared, deque(calls), list(self._started))
        Thread(target=self._evaluate, args=arguments, daemon=True).start()
        return [future for _, future in calls]

    def _evaluate(
        self, shared: Any, calls: deque[tuple[int, Future[Row]]], free: list[Any]
    ) -> None:
        """Send the calls to free actors; runs in its own thread."""
        running: dict[Any, tuple[Future[Row], Any]] = {}
        while not self._closed:
            while free and calls:
                seed, future = calls.popleft()
                if future.set_running_or_notify_cancel():
                    actor = free.pop()
                    running[actor.evaluate.remote(shared, seed)] = future, actor
            if not running:
                return  # the learner plays the rest
            ready, _ = self._ray.wait(list(running), timeout=POLL)
            for reference in ready:
                future, actor = running.pop(reference)
                try:
                    future.set_result(self._get(reference, actor))
                    free.append(actor)
                except Exception as error:  # noqa: BLE001 - raised where the row is awaited
                    future.set_exception(error)

    def _get(self, reference: Any, actor: Any) -> Any:
        """Return the result of a call to an actor.

        Raises:
            WorkerDiedError: the actor or its result was lost.
        """
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
        ) as error:
            with contextlib.suppress(ValueError):  # both its requests were lost
                self._started.remove(actor)
                self._await_start(actor)
            raise WorkerDiedError("a Ray worker was lost") from error

    def outstanding(self) -> list[RolloutRequest]:
        """Return the requests that were sent but not yet taken, oldest first."""
        return [*(request for request, _ in self._sent.values()), *self._queue]

    def close(self) -> None:
        """Stop the actors; close the connection if this object made it."""
        self._closed = True
        for actor in [*self._started, *self._starting.values()]:
            self._ray.kill(actor)
        if self._owned:
            self._ray.shutdown()
