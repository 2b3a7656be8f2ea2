"""Workers on a Ray cluster, which is started here, or joined at an address.

A worker takes calls once it has a CPU and has started; the others wait for a CPU. When a worker or
its node is lost, its call is lost, and another one starts on a node with a free CPU.
"""

from __future__ import annotations

import contextlib
import math
import os
import platform
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from flipperctl.errors import ConfigError, FlipperctlError, missing_extra
from flipperctl.plugging.guard import naming_plugins
from flipperctl.rollout.pool import POLL, DiedError, import_path

LOCAL = "local"
"""Address that stands for a cluster of this machine, started for this process alone."""

QUIET: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
"""Settings of ``ray.init`` for a process that shows its own messages."""
_PATIENCE = 10.0
"""Longest wait for a host's answer [s]; Ray itself would try for minutes."""


_SKIPPED = "RAY_DEDUP_LOGS_SKIP_REGEX"
_NODE_LOGS = r"^Raylet is terminated|^The node with node id|\[state-dump\]"
"""Messages of Ray about a lost node, with dozens of lines of its log."""


def import_ray() -> Any:
    """Return the module ``ray``, which prints no log of a node that is lost."""
    if "ray" in sys.modules:
        return sys.modules["ray"]
    # The pattern joins one that the user has set, for the time of the import only.
    before = os.environ.get(_SKIPPED)
    os.environ[_SKIPPED] = f"{before}|{_NODE_LOGS}" if before else _NODE_LOGS
    try:  # Ray reads the variable while it is imported
        import ray
    except ImportError as error:
        raise missing_extra("collector=ray", "ray") from error
    finally:
        del os.environ[_SKIPPED]
        os.environ.update({} if before is None else {_SKIPPED: before})
    return ray


@contextlib.contextmanager
def connected(address: str, key: str, cpus: int) -> Iterator[None]:
    """Connect to a cluster, unless this process is connected; disconnect from it afterwards.

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
        # Ray would try an address without an answer for minutes: ask its port first.
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
        # Ray's texts may fill a page: the error has one line of them.
        reason = " ".join(str(error).split())[:200]
        if isinstance(error, ValueError):  # raised before connecting, about the settings
            raise ConfigError(f"{key}: Ray cannot use {address!r}: {reason}") from error
        raise ConfigError(f"{key}: no Ray cluster answers at {address!r}: {reason}") from error


def is_connected() -> bool:
    """Return whether this process is connected to a cluster; Ray is not imported for it."""
    ray = sys.modules.get("ray")
    return ray is not None and bool(ray.is_initialized())


def node() -> str:
    """Return the name of this machine, with its address in the cluster if it works for one."""
    if not is_connected():
        return platform.node()
    context = import_ray().get_runtime_context()
    address = import_ray().util.get_node_ip_address()
    return f"{platform.node()} ({address}, Ray node {context.get_node_id()[:12]})"


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
    # ray.init would repeat a refused token for 20 s; nothing public of Ray asks a cluster once.
    if "://" not in str(address):
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
        """Sentences for the user about hosts that are not ready."""
        self._lock = threading.Lock()
        self._living: set[RayHost] = set()
        self._reported: tuple[int, int] = (0, 0)
        self._changed_at = self._answered_at = time.monotonic()

    @property
    def started(self) -> int:
        """Number of living hosts that have answered a call."""
        with self._lock:
            return sum(host.started for host in self._living)

    def start(self) -> RayHost:
        """Start a host; its first call waits for a CPU."""
        remote: Any = import_ray().remote(_Actor)
        host = RayHost(remote.options(num_cpus=1).remote(str(Path.cwd())), self)
        with self._lock:
            self._living.add(host)
        return host

    def answered(self, host: RayHost) -> None:
        """Note that a call of a host has ended; the first one tells that it has started."""
        with self._lock:
            self._answered_at = time.monotonic()
            if not host.started:
                host.started, self._changed_at = True, self._answered_at

    def ended(self, host: RayHost) -> None:
        """Forget a host that has ended."""
        with self._lock:
            self._living.discard(host)

    def wait(self, since: float, host: RayHost) -> None:
        """Raise an error if the patience with a host's call that began at ``since`` is over."""
        # Any worker's answer renews the patience, since all calls wait in one queue.
        now, patience = time.monotonic(), f"{self._patience:g} s (collector.patience)"
        over = now - max(since, self._answered_at) > self._patience
        if over and host.started:
            raise FlipperctlError(f"no Ray worker has played an episode for {patience}")
        if over and not self.started:
            free, total = cpus()
            raise FlipperctlError(
                f"no Ray worker got a CPU and started within {patience}: {free} of the cluster's "
                f"{total} CPUs are free; wait for other jobs to end, or add machines"
            )
        # Say only what has changed, and give new workers time to start before that.
        with self._lock:
            if host.started or now <= self._changed_at + _REPORT_AFTER:
                return
            self._changed_at = now
            late = [other for other in self._living if not other.started]
            starting = sum(other.has_cpu for other in late)
            state = starting, len(late) - starting
            if state != self._reported:
                self._reported = state
                self._report(*state)

    def _report(self, starting: int, waiting: int) -> None:
        """Note how many hosts have a CPU but are still importing, and how many wait for one."""
        workers = f"of {self._count} Ray workers (collector.workers)"
        if waiting:
            free, total = cpus()
            if free:  # the cluster is about to assign them
                return
            already = self._count - waiting
            rest = f"The run waits up to {self._patience:g} s (collector.patience) for one"
            if already:
                rest = f"The run continues with {already}; others join when a CPU is free"
            self.notes.put(
                f"{waiting} {workers} have no CPU: none of the cluster's {total} is free. {rest}"
            )
        elif starting:
            self.notes.put(f"{starting} {workers} are starting")


class RayHost:
    """An actor that answers one call at a time."""

    alive = True  # one that was lost says so at its next call

    def __init__(self, handle: Any, hosts: Hosts) -> None:
        self._handle, self._hosts = handle, hosts
        self.started = False
        """Whether it has answered a call."""
        self._placed = handle.__ray_ready__.remote()
        self._ending = ""

    @property
    def has_cpu(self) -> bool:
        """Whether the cluster has started its process, which takes a CPU."""
        return bool(import_ray().wait([self._placed], timeout=0)[0])

    def call(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        """Return ``function(*arguments)`` of the actor, or raise what it raised there."""
        ray, hosts = import_ray(), self._hosts
        errors = ray.exceptions
        # A call waits for a CPU, possibly for ever; polling lets the hosts' patience end it.
        reference = self._handle.call.remote(function, *arguments)
        begun = time.monotonic()
        try:
            while not ray.wait([reference], timeout=POLL)[0]:
                hosts.wait(begun, self)
            value = ray.get(reference)
        # Ray wraps what the function raised in its own text: raise the original.
        except errors.RayTaskError as error:
            if isinstance(error.cause, FlipperctlError):  # without the text of Ray
                raise error.cause from None
            raise error.as_instanceof_cause() from None
        except (errors.RayActorError, errors.ObjectLostError, errors.WorkerCrashedError) as error:
            self._ending = f"was lost: {str(error).strip().splitlines()[-1]}"
            raise DiedError from error
        hosts.answered(self)
        return value

    def end(self) -> str:
        """End the actor, even within a call; return in words how it ended."""
        # Without its handle a second call of this method kills nothing.
        if self._handle is not None:
            handle, self._handle = self._handle, None
            import_ray().kill(handle)
            self._hosts.ended(self)
        return self._ending or "was stopped"


class _Actor:
    """Answers the calls of a ``RayHost`` in a process of the cluster."""

    def __init__(self, folder: str) -> None:
        """``folder``: working directory of the learner, to which relative paths refer."""
        if Path(folder).is_dir():
            os.chdir(folder)

    def call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``function(*arguments)``."""
        with naming_plugins():
            return function(*arguments)
