"""Run measures of speed one after another, and collect their results.

In: the words of a command, a suite of measures and their inputs. Out: one document of plain data,
and ``bench.json`` in a folder that the user names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from flipperctl.bench.settings import Bench, Sizes, load, machine
from flipperctl.errors import RequestError
from flipperctl.messages import close_match
from flipperctl.results import json_result

MOVED = ("physics", "accuracy", "lookahead", "solve", "startup")
"""Measures of version 0.2 that now run only in a clone of the repository."""
Progress = Callable[[str], AbstractContextManager[Callable[[str, float], None]]]
"""Returns a context that shows the progress of the measure with the given name."""


def split_arguments(arguments: Sequence[str], known: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the measures, in the order of those ``known``, and the overrides.

    Raises:
        RequestError: a word is neither a measure nor an override, or a measure that has moved.
    """
    overrides = [a for a in arguments if "=" in a or a.startswith("~")]
    names = [a for a in arguments if a not in overrides]
    allowed = ("all", *known)
    for name in names:
        if name in MOVED and name not in known:
            raise RequestError(
                f"the measure {name!r} is no longer installed; in a clone of the repository, run "
                f"python -m benchmarks {name}"
            )
        if name not in allowed:
            raise RequestError(
                f"there is no measure {name!r}{close_match(name, allowed)}; "
                f"known: {', '.join(allowed)}; an override is key=value"
            )
    every = not names or "all" in names
    return [m for m in known if every or m in names], overrides


def run_measures(
    package: str,
    measures: Sequence[str],
    inputs: Bench[Sizes],
    overrides: Sequence[str],
    *,
    output: Path | None,
    progress: Progress,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Run the measures, modules of ``package``; return their results as plain data.

    ``overrides`` are added to the results. ``tell`` is called with a line for each measurement
    that was not possible.

    Raises:
        OutputError: ``output``, a folder, cannot be written.
    """
    document: dict[str, Any] = {
        "machine": machine(),
        "settings": inputs.settings.model_dump(mode="json"),
        "overrides": list(overrides),
        "measures": {},
    }
    with json_result(output, "bench") as write:
        for name in measures:
            with progress(name) as report:
                measure = import_module(f"{package}.{name}").measure
                found = measure(replace(inputs, report_progress=report))
            document["measures"][name] = {**found, "load_average": load()}
            for text in found.get("missing", ()):
                tell(f"{name}: {text}")
            write(document)  # after each measure, since the next may take an hour
    return document
