"""What a finished run holds, without times, and how it differs from another."""

import hashlib
import json
from pathlib import Path
from typing import Any

from flipperctl import checkpoint
from flipperctl.text.files import read_csv

_TIMES = ("seconds", "usage")
"""Entries that differ between equal runs; the usage of workers is that of longer ones."""


def result(run: Path) -> dict[str, Any]:
    """Return the contents of a finished run without times; equal runs have equal results."""
    found: dict[str, Any] = {}
    for name in (checkpoint.BEST, checkpoint.LAST):
        saved = checkpoint.read(run / name)
        digest = hashlib.sha256()
        for key in sorted(saved.tensors):
            digest.update(key.encode() + saved.tensors[key].numpy().tobytes())
        found[f"{name.stem} tensors"] = digest.hexdigest()
        found[f"{name.stem} document"] = _without_times(saved.document)
    found["metrics"] = [_without_times(row) for row in read_csv(run / "metrics.csv")]
    found["summary"] = _without_times(json.loads((run / "summary.json").read_text()))
    return found


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if k not in _TIMES}
    return value


def differences(run: Path, reference: dict[str, Any]) -> list[str]:
    """Return the parts of a run that differ from the reference, or the error of reading the run."""
    try:
        found = result(run)
    except Exception as error:  # noqa: BLE001 (a missing or damaged part is a difference)
        return [f"{type(error).__name__}: {error}"]
    return [part for part, value in reference.items() if found[part] != value]
