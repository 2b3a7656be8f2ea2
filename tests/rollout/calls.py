"""Calls for workers of a pool; a worker that is spawned imports nothing but this file for them."""

import importlib
import os
import signal
import sys
import time
from pathlib import Path


def initialize(module: str = "json") -> None:
    importlib.import_module(module)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def die_first(died: Path) -> None:
    if not died.exists():
        died.touch()
        die()


def fail(error: BaseException) -> None:
    raise error


def wait_for(path: Path, limit: float = 20.0) -> bool:
    end = time.monotonic() + limit
    while not path.exists() and time.monotonic() < end:
        time.sleep(0.01)
    return path.exists()


def touch(path: Path) -> None:
    path.touch()


def mask() -> set[int]:
    return {int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, ())}


def torch_is_imported() -> bool:
    return "torch" in sys.modules
