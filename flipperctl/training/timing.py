"""How long a run took so far: ``timing.json``, apart from the checkpoints.

Checkpoints of equal runs are then equal files, whatever the clock said.
"""

from __future__ import annotations

import json
import math
import time
from pathlib import Path

from flipperctl.files import write_json

NAME = "timing.json"


class Stopwatch:
    """The time that a run took, over all its starts."""

    def __init__(self, directory: Path) -> None:
        self._path = directory / NAME
        self._earlier = 0.0
        self._begun = time.perf_counter()

    @property
    def seconds(self) -> float:
        """The time until now [s]."""
        return self._earlier + time.perf_counter() - self._begun

    def start(self) -> None:
        """Begin to count, after the time that ``read`` found."""
        self._begun = time.perf_counter()

    def write(self) -> None:
        """Note the time until now."""
        write_json(self._path, {"seconds": round(self.seconds, 3)})

    def read(self) -> None:
        """Go on from the time of the last checkpoint; from 0 where nothing usable tells it."""
        try:
            seconds = json.loads(self._path.read_text(encoding="utf-8"))["seconds"]
        except (OSError, ValueError, RecursionError, LookupError, TypeError):
            return  # the clock is a comfort; a run goes on without it
        if isinstance(seconds, int | float) and math.isfinite(seconds) and seconds >= 0:
            self._earlier = float(seconds)
