"""The option ``--quick``: the tests of single parts, each of which must stay quick.

Folders that train, evaluate, start processes or speak through the command line are not among them.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.machine_code import compile_environment

FOLDERS = ("agent", "checkpoint", "config", "core", "env", "runtime", "sim")
FILES = ("test_api.py", "test_transitions.py")
LIMIT = 3.0
"""Largest computing time of a quick test, its child processes included [s]."""

ROOT = Path(__file__).parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help="run the quick tests alone")


def is_quick(item: pytest.Item) -> bool:
    """Return whether the test is in a quick folder and not marked as slow."""
    first = item.path.relative_to(ROOT).parts[0]
    return first in (*FOLDERS, *FILES) and item.get_closest_marker("slow") is None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the quick tests, or begin with the slow files, so that no worker ends with them."""
    if not config.getoption("--quick"):
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)  # it is stable
        return
    left = [item for item in items if not is_quick(item)]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item in items if is_quick(item)]


@pytest.fixture(scope="session", autouse=True)
def machine_code(request: pytest.FixtureRequest) -> None:
    """Compile what the quick tests use, or read it from the cache, outside any test's time."""
    if request.config.getoption("--quick"):
        compile_environment()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test of ``--quick`` that is not quick."""
    begun = os.times()
    yield
    spent = sum(os.times()[:4]) - sum(begun[:4])
    if item.config.getoption("--quick") and spent > LIMIT:
        pytest.fail(
            f"it computes for {spent:.1f} s; a quick test may take {LIMIT:g} s: "
            "make it faster, or mark it with pytest.mark.slow",
            pytrace=False,
        )
