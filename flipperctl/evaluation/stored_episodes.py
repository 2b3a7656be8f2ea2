"""Read the episodes of each policy that one ``eval --output`` wrote, and what its files say of it.

In: a folder with ``episodes.csv``. Out: episodes by policy, scene and seed.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from flipperctl.api import Outcome
from flipperctl.errors import RequestError
from flipperctl.evaluation.best_known import is_best_known
from flipperctl.evaluation.files import SUMMARY
from flipperctl.evaluation.store import FOLDER, PlayedPolicy, played_policies
from flipperctl.messages import close_match

FILE = "episodes.csv"
_KEYS = ("scene", "controller", "conditions_hash", "seed", "outcome")

Episodes = Mapping[str, Mapping[str, tuple[float, bool]]]
"""Of one policy: measure and whether the finish was reached, by scene and the episode's seed."""


def policies(path: Path, measure: str) -> dict[str, Episodes]:
    """Return the episodes of each policy of a file, the evaluated one before its baselines."""
    found: dict[str, dict[str, dict[str, tuple[float, bool]]]] = {}
    try:
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            columns = reader.fieldnames or ()
            for key in (*_KEYS, measure):
                if key not in columns:
                    raise RequestError(
                        f"{path}: there is no column {key!r}{close_match(key, columns)}"
                    )
            for row in reader:
                if is_best_known(row["controller"]):
                    continue  # it stands only where it beats all others
                scene = f"{row['scene']} {row['conditions_hash']}"
                value = float(row[measure])
                if not np.isfinite(value):
                    raise ValueError(f"{measure} {row[measure]!r}")
                played = found.setdefault(row["controller"], {}).setdefault(scene, {})
                found_here = value, row["outcome"] == Outcome.REACHED
                if played.setdefault(row["seed"], found_here) != found_here:
                    raise RequestError(
                        f"{path}: {row['controller']} has several results on {scene}, seed "
                        f"{row['seed']}, as with several of its settings; a folder of "
                        "eval --output for each of them, named as in METHOD=DIR, is allowed"
                    )
    except (OSError, UnicodeDecodeError, csv.Error, ValueError, TypeError) as error:
        raise RequestError(f"{path}: cannot be read: {error}") from error
    if not found:
        raise RequestError(f"{path}: there is no episode in it")
    return dict(found)


def played(folder: Path) -> dict[str, set[PlayedPolicy]]:
    """Return the policies whose cells lie beside the episodes of a folder, by label."""
    found: dict[str, set[PlayedPolicy]] = {}
    for (label, _), policies in played_policies(folder / FOLDER).items():
        found.setdefault(label, set()).update(policies)
    return found


def grouped(folder: Path) -> dict[str, str]:
    """Return the method of each policy, by label, where one evaluation had several of its seeds."""
    try:
        scenes = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["scenes"]
        labels: dict[str, set[str]] = {}
        for scene in scenes:
            if method := scene.get("method"):
                labels.setdefault(method, set()).add(scene["controller"])
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return {}  # the episodes alone are needed
    return {label: name for name, found in labels.items() if len(found) > 1 for label in found}
