"""Workers on a Ray cluster, which is started here, or joined at an address.

A worker takes calls once it has a CPU and has started; the others wait for a CPU. When a worker or
its node is lost, its call is lost, and another one starts on a node with a free CPU.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from flipperctl.errors import ConfigError, FlipperctlError, MissingExtraError
from flipperctl.rollout.pool import POLL, DiedError, import_path

LOCAL = "local"
"""Address that stands for a cluster of this machine, started for this process alone."""

QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
"""Settings of ``ray.init`` for a process that shows its own messages."""
_PATIENCE = 10.0
"""Longest wait for a host's answer [s]; Ray itself would try for minutes."""


def import_ray() -> Any:
    """Return the module ``ray``."""
    try:
        import ray
    except ImportError as error:
        raise MissingExtraError("collector=ray needs Ray: pip install flipperctl[ray]") from error
    return ray


@contextlib.contextmanager
def connected(address: str, key: str, cpus: int) -> Iterator[None]:
    """Be connected to a cluster, unless this process already is; disconnect from it afterwards.

    ``key``: configuration path of the address, for the errors of ``join``. A cluster at ``LOCAL``
    gets ``cpus`` CPUs.
    """
    if import_ray().is_initialized():
        yield
        return
    if address == LOCAL:  # Ray's "local" does not join a cluster of this machine
        join(LOCAL, key, num_cpus=cpus, include_dashboard=False, **QUIET)
    else:
        join(address, key, **QUIET)
    try:
        yield
    finally:
        shut_down()


def join(address: str | None, key: str, **settings: Any) -> None:
    """Connect to a running cluster; ``settings`` are passed on to ``ray.init``.

    ``key``: configuration path of the address, for the errors. Without an address, Ray joins a
    cluster on this machine, or starts one.
    """
    ray = import_ray()
    if "runtime_env" not in settings:  # which may have an import path of its own
        from ray.job_config import JobConfig

        # Ray lets workers import from the working directory first, except those of a client's job.
        # A worker inserts one folder after the other at the head of its path.
        job = JobConfig(_client_job=True, _py_driver_sys_path=import_path()[::-1])
        settings = {"job_config": job, **settings}
    try:
        _check_reachable(address)
        before = signal.getsignal(signal.SIGTERM)  # ``ray.init`` replaces it by an exit
        try:
            ray.init(address=address, **settings)
        finally:
            with contextlib.suppress(ValueError):  # not in the main thread
                signal.signal(signal.SIGTERM, before)
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
    cause: BaseException | None = error
    while cause is not None and "AuthenticationError" not in f"{type(cause).__name__} {cause}":
        cause = cause.__cause__
    return cause is not None


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


_REPORT_AFTER = 10.0
"""Time after which workers that still wait for a CPU are reported [s]."""


class Hosts:
    """Starts hosts of a worker pool on the cluster, each with a CPU, and watches how they fare."""

    def __init__(self, count: int, patience: float = math.inf) -> None:
        """``count``: workers of the pool.

        ``patience``: longest time of waiting calls without the end of one, before they fail [s].
        """
        self._count, self._patience = count, patience
        self.notes: SimpleQueue[str] = SimpleQueue()
        """Sentences for the user about hosts that get no CPU."""
        self._lock = threading.Lock()
        self.started = self._starting = self._reported = 0
        self._changed_at = self._answered_at = time.monotonic()

    def start(self) -> RayHost:
        """Start a host; its first call waits for a CPU."""
        remote: Any = import_ray().remote(_Actor)
        handle = remote.options(num_cpus=1).remote(str(Path.cwd()))
        with self._lock:
            self._starting += 1
        return RayHost(handle, self)

    def answered(self, *, first: bool) -> None:
        """Note that a call has ended; the first one of a host tells that it has started."""
        with self._lock:
            self._answered_at = time.monotonic()
            if first:
                self._starting, self.started = self._starting - 1, self.started + 1
                self._changed_at = self._answered_at

    def ended(self, started: bool) -> None:
        """Count a host that has ended."""
        with self._lock:
            self.started, self._starting = self.started - started, self._starting - (not started)

    def wait(self, since: float, started: bool) -> None:
        """Raise an error if the patience with a call that began at ``since`` is over."""
        now, patience = time.monotonic(), f"{self._patience:g} s (collector.patience)"
        over = now - max(since, self._answered_at) > self._patience
        if over and started:
            raise FlipperctlError(f"no Ray worker has played an episode for {patience}")
        if over and not self.started:
            free, total = cpus()
            raise FlipperctlError(
                f"no Ray worker got a CPU and started within {patience}: {free} of the cluster's "
                f"{total} CPUs are free; wait for other jobs to end, or add machines"
            )
        with self._lock:
            late = now > self._changed_at + _REPORT_AFTER and not started
            if not late or self._starting == self._reported:
                return
            self._changed_at, waiting = now, self._starting
            free, total = cpus()
            if free:
                return
            self._reported = waiting
        rest = f"The run waits up to {patience} for one"
        if self.started:
            rest = f"The run continues with {self.started}; others join when a CPU is free"
        self.notes.put(
            f"{waiting} of {self._count} Ray workers (collector.workers) have no CPU: "
            f"none of the cluster's {total} is free. {rest}"
        )


class RayHost:
    """An actor that answers one call at a time."""

    idle = True  # one that was lost says so at its next call

    def __init__(self, handle: Any, hosts: Hosts) -> None:
        self._handle, self._hosts = handle, hosts
        self._started = False
        self._ending = ""

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)`` of the actor, or raise what it raised there."""
        ray, hosts = import_ray(), self._hosts
        errors = ray.exceptions
        reference = self._handle.call.remote(function, *arguments)
        begun = time.monotonic()
        try:
            while not ray.wait([reference], timeout=POLL)[0]:
                hosts.wait(begun, self._started)
            value = ray.get(reference)
        except errors.RayTaskError as error:
            if isinstance(error.cause, FlipperctlError):  # without the text of Ray
                raise error.cause from None
            raise error.as_instanceof_cause() from None
        except (errors.RayActorError, errors.ObjectLostError, errors.WorkerCrashedError) as error:
            self._ending = f"was lost: {str(error).strip().splitlines()[-1]}"
            raise DiedError from error
        hosts.answered(first=not self._started)
        self._started = True
        return value

    def end(self, *, kill: bool) -> str:
        """End the actor, even within a call; return in words how it ended."""
        if self._handle is not None:
            handle, self._handle = self._handle, None
            import_ray().kill(handle)
            self._hosts.ended(self._started)
        return self._ending or "was stopped"


class _Actor:
    """Answers the calls of a ``RayHost`` in a process of the cluster."""

    def __init__(self, folder: str) -> None:
        """``folder``: working directory of the learner, to which relative paths refer."""
        if Path(folder).is_dir():
            os.chdir(folder)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``function(*arguments)``."""
        return function(*arguments)
