"""A logger that fails is dropped with one warning, and the training goes on."""

from pathlib import Path
from typing import Any

import pytest

from flipperctl.api import Listener, Logger, RunInfo
from flipperctl.config.guarded import guard_class
from flipperctl.errors import MissingExtraError
from flipperctl.training.listeners import GuardedLogger
from tests.training.test_closing import Faulty


class Broken(Logger):
    """Opens a listener that fails."""

    plugin_name = "broken"
    listener: Any = None

    def open(self, run: RunInfo) -> Listener:
        if isinstance(self.listener, BaseException):
            raise self.listener
        found: Listener = self.listener
        return found


def guarded(listener: Any, folder: Path) -> GuardedLogger:
    """Open the logger as a training does, whose plugins are guarded when they are created."""
    guard_class(Broken)
    return GuardedLogger(Broken(listener=listener), RunInfo(folder, folder / "broken", {}, None))


@pytest.mark.parametrize("method", ["open", "episode", "validation", "note", "close"])
def test_it_is_dropped_with_one_warning(
    method: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    listener = Faulty(method)
    logger = guarded(ValueError("no disk") if method == "open" else listener, tmp_path)
    for _ in range(2):
        logger.episode({})
        logger.validation({})
        logger.note("a note")
    logger.close()
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"warning: logger 'broken': {method} raised ")
    assert "PluginFailedError" not in line
    assert line.endswith("the training continues without it")
    assert listener.closed == (method != "open")


def test_a_missing_package_refuses_the_training(tmp_path: Path) -> None:
    with pytest.raises(MissingExtraError, match=r"logger=broken: install flipperctl\[broken\]"):
        guarded(ImportError("install flipperctl[broken]"), tmp_path)


def test_an_interrupt_is_the_user_s(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        guarded(KeyboardInterrupt(), tmp_path)
