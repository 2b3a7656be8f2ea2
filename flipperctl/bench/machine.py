"""Description of the machine that a benchmark runs on: versions, processor, load and date."""

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
    """Return date, versions (None if not installed), system, processor, cores and load."""
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
        "cores_allowed": _allowed_cores(),
        "load_average": load(),
    }


def load() -> list[float] | None:
    """Return the load averages over the last 1, 5 and 15 minutes [-]; None if unavailable."""
    return list(os.getloadavg()) if hasattr(os, "getloadavg") else None


def processor(listing: Path = Path("/proc/cpuinfo")) -> str:
    """Return the processor's model name."""
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


def _allowed_cores() -> int | None:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count()
