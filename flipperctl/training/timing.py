"""The time that a run has taken, in ``timing.json``.

It is separate from the checkpoints, so that equal runs have equal checkpoint files.
"""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

from flipperctl.files import write_json

NAME = "timing.json"


class Stopwatch:
    """Measures the time of a run over all its starts."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / NAME
        self._earlier = 0.0
        self._started_at = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Time that the run has taken so far [s]."""
        return self._earlier + time.perf_counter() - self._started_at

    def start(self) -> None:
        """Start counting, on top of the time from ``read``."""
        self._started_at = time.perf_counter()

    def write(self) -> None:
        """Write the time so far to ``timing.json``."""
        write_json(self._path, {"seconds": round(self.seconds, 3)})

    def read(self) -> None:
        """Read the time at the last checkpoint; keep 0 if the file is missing or not valid."""
        try:
            seconds = json.loads(self._path.read_text(encoding="utf-8"))["seconds"]
        except (OSError, ValueError, RecursionError, LookupError, TypeError):
            return  # the time is not needed to resume a run
        if isinstance(seconds, int | float) and math.isfinite(seconds) and seconds >= 0:
            self._earlier = float(seconds)
