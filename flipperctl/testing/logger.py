"""Checks of a logger on the rows of a stopped and resumed training."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from flipperctl.api import Logger, Outcome, RunInfo
from flipperctl.testing.check import NotChecked, require

_ROW: dict[str, Any] = {
    **{"episode": 1, "seed": 7, "terrain": "flat", "outcome": Outcome.REACHED},
    **{"success_rate": 1.0, "return": -2.5, "loss": None},
}


def records(logger: Logger) -> None:
    """Check that it records a resumed run and writes only to its own folder."""
    with TemporaryDirectory() as name:
        directory = Path(name)
        for resume_at, decisions in ((None, (20, 40)), (20, (40, 60))):
            run = RunInfo(directory, directory / logger.plugin_name, {"seed": 1}, resume_at)
            try:
                listener = logger.open(run)
            except ImportError as error:
                raise NotChecked(str(error)) from error
            for decision in decisions:
                listener.episode({**_ROW, "decision": decision})
            listener.validation({**_ROW, "decision": decisions[-1]})
            listener.note("a worker was replaced")
            listener.close()
        others = sorted(p.name for p in directory.iterdir() if p.name != logger.plugin_name)
        require(not others, f"writes {others} beside its own folder; write to run.folder")
