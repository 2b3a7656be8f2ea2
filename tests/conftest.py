"""What every test shares: the built-in plugins, and a registry that is put back."""

import gc
import os
import signal

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read once, by numpy and torch; children inherit it

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from _pytest import runner

from flipperctl import api
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.export import policy
from flipperctl.plugging import plugins
from tests.short import few, trainer

pytest_plugins = ["tests.quick"]

os.environ.pop("COLUMNS", None)  # pytest-xdist sets it, and tables would keep to it
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as shells start what runs behind them
    # Processes inherit it, and tests interrupt them.
    signal.signal(signal.SIGINT, signal.default_int_handler)
plugins.load()  # at import, since tests are parametrised over the registry
policy.OBSERVATIONS = 100  # on which a file is compared with its network; test_export.py has 1000


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what is imported, which is a fifth of the tests' time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def _within_one_stack(work: Callable[[], bool]) -> bool:
    return work()


_within_one_stack.__code__ = _within_one_stack.__code__.replace(co_stacksize=70_000)
"""Python keeps its frames in chunks of 16 kB, and asks the system for one whenever a call crosses
the end of the last. Where a test recurses around such an end, as when Hydra copies, 75 000 chunks
come and go in a second. A frame of 560 kB gets a chunk of 1 MiB, whose rest holds all frames."""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool:
    """Run each test within one chunk of Python's stack, which saves a tenth of the tests' time."""
    return _within_one_stack(lambda: runner.pytest_runtest_protocol(item, nextitem))


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict]:
    """The plugin registry; what a test registers or loads is forgotten behind it."""
    before = dict(api.registry)
    monkeypatch.setattr(plugins, "_loaded", set(plugins._loaded))
    monkeypatch.setattr(plugins, "_given", [])
    monkeypatch.setenv(plugins.VARIABLE, "")
    yield api.registry
    api.registry.clear()
    api.registry.update(before)


@pytest.fixture(scope="session")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of a finished training run of 300 decisions; read it, never change it."""
    folder = tmp_path_factory.mktemp("short_run")
    trainer(few(), folder).run()
    return folder


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The indices of the episodes of an evaluation that are played in this process."""
    found: list[int] = []
    play = EpisodeRunner.play

    def counted(self: EpisodeRunner, index: int) -> object:
        found.append(index)
        return play(self, index)

    monkeypatch.setattr(EpisodeRunner, "play", counted)
    return found
