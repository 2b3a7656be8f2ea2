"""How long a run took so far: ``timing.json``, apart from the checkpoints.

Checkpoints of equal runs are then equal files, whatever the clock said.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

from flipperctl.files import write_json

NAME = "timing.json"


def write(directory: Path, seconds: float) -> None:
    """Note the time that a run took until now [s]."""
    write_json(directory / NAME, {"seconds": round(seconds, 3)})


def read(directory: Path) -> float:
    """The time that a run took until its last checkpoint [s]; 0 where nothing usable says so."""
    try:
        seconds = json.loads((directory / NAME).read_text(encoding="utf-8"))["seconds"]
    except (OSError, ValueError, RecursionError, LookupError, TypeError):
        return 0.0  # the clock is a comfort; a run goes on without it
    usable = isinstance(seconds, int | float) and math.isfinite(seconds) and seconds >= 0
    return float(seconds) if usable else 0.0
