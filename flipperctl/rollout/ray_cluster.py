"""The Ray cluster of this process: started here, or joined at an address.

In: an address and further settings of ``ray.init``. Out: a connection, or an error that names the
wrong setting.
"""

from __future__ import annotations

import contextlib
import signal
import socket
import sys
from collections.abc import Iterator
from typing import Any

from flipperctl.errors import ConfigError, MissingExtraError
from flipperctl.rollout.children import import_path

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
