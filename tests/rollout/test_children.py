"""Worker processes import what this process has imported, and leave it as it was."""

import errno
import importlib
import os
import random
import resource
import signal
import sys
from multiprocessing import Pipe
from pathlib import Path
from typing import Any

import pytest

import flipperctl
from flipperctl.errors import FlipperctlError
from flipperctl.rollout import children
from flipperctl.rollout.pool import WorkerPool

HOSTILE = ("random", "signal", "queue", "numbers", "numpy", "torch", "pickle", "socket", "struct")


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: it holds files named like modules, and a folder ``flipperctl``."""
    (tmp_path / "flipperctl").mkdir()
    for name in HOSTILE:
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(children._Server, "_current", None)  # or it was started elsewhere
    return tmp_path


def initialize(module: str = "torch") -> None:
    importlib.import_module(module)


def places(names: tuple[str, ...]) -> list[str | None]:
    return [getattr(importlib.import_module(name), "__file__", None) for name in names]


def stop() -> None:
    raise EOFError("on purpose")


def mask() -> set[int]:
    return {int(number) for number in signal.pthread_sigmask(signal.SIG_BLOCK, ())}


def asked(count: int, function: Any, *arguments: Any, first: Any = ()) -> Any:
    workers = WorkerPool(count, initialize, first)
    try:
        return workers.submit(function, *arguments).result()
    finally:
        workers.close()


@pytest.mark.parametrize("count", [1, 2])  # spawned, and forked from a server
@pytest.mark.usefixtures("hostile")
def test_nothing_is_imported_from_the_working_directory(count: int) -> None:
    names = ("flipperctl", "flipperctl.rollout.worker", *HOSTILE)
    assert asked(count, places, names) == places(names)


def test_what_was_imported_is_found_where_it_was_though_the_path_has_changed(
    hostile: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A script may import the package first, and look into another folder later."""
    (hostile / "helper_of_a_script.py").write_text("")
    monkeypatch.syspath_prepend(str(hostile))
    names = ("flipperctl", "random", "numpy", "helper_of_a_script")
    found = [flipperctl.__file__, random.__file__, sys.modules["numpy"].__file__]
    assert asked(1, places, names) == [*found, str(hostile / "helper_of_a_script.py")]


def test_a_worker_that_cannot_start_says_why() -> None:
    with pytest.raises(
        FlipperctlError, match=r"^worker process 0 cannot start: ModuleNotFound.*x_y"
    ):
        asked(2, mask, first=("x_y",))


def test_an_error_that_ends_input_is_the_error_of_the_call() -> None:
    with pytest.raises(EOFError, match="on purpose"):
        asked(2, stop)


@pytest.mark.parametrize("count", [1, 2])
def test_a_system_that_refuses_a_process_is_named_with_what_works(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> Any:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    asked(2, mask)  # the server runs
    monkeypatch.setattr(children, "Pipe", refuse)
    with pytest.raises(
        FlipperctlError, match=r"Too many open files; .*--jobs 1 .*train.mode=exact"
    ):
        asked(count, mask)


def test_no_signal_is_blocked_in_a_worker() -> None:
    assert asked(2, mask) == asked(1, mask) == mask() == set()


def test_a_worker_needs_few_descriptors() -> None:
    """A limit of 64 open files, of which a test may have many, bears two workers."""
    ours, theirs = Pipe()
    lowest = ours.fileno()
    ours.close()
    theirs.close()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    asked(2, mask)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(64, lowest + 16), hard))
    try:
        assert asked(2, mask) == set()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_server_that_died_is_replaced() -> None:
    asked(2, mask)
    server = children._Server._current
    assert server is not None
    os.kill(server._process.pid, signal.SIGKILL)
    server._process.wait()
    assert asked(2, mask) == set()
    assert children._Server._current is not server
