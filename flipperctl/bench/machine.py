"""What the numbers were measured with: versions, processor, load, date."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from flipperctl import __version__

PACKAGES = (
    "torch",
    "numpy",
    "pymunk",
    "gymnasium",
    "numba",
    "stable-baselines3",
    "onnxruntime",
    "ray",
)


def machine() -> dict[str, Any]:
    """Versions (None: not installed), processor, cores, load and time of day."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "flipperctl": __version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in PACKAGES},
        },
        "system": f"{platform.system()} {platform.release()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "cores_allowed": _allowed(),
        "load_average": load(),
    }


def load() -> list[float] | None:
    """Processes that run or wait to run, over the last 1, 5 and 15 minutes [-]."""
    return list(os.getloadavg()) if hasattr(os, "getloadavg") else None


def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """The processor's model, as the system calls it."""
    if listing.is_file():
        for line in listing.read_text().splitlines():
            key, _, value = line.partition(":")
            if key.strip().lower() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _allowed() -> int | None:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count()
