"""``flipperctl eval --map``: success over two settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def run_map(
    text: str,
    words: list[str],
    checkpoint: Path | None,
    controller: str | None,
    output: Path | None,
    *,
    as_json: bool,
    others: dict[str, Any],
) -> None:
    """Print a map and write its files; ``others`` are options that a map does not take.

    Raises:
        RequestError: one of the ``others`` is given.
        InterruptedRunError: the map was interrupted; what is finished is printed and written.
    """
    from flipperctl.cli.scenes import scenes
    from flipperctl.errors import InterruptedRunError
    from flipperctl.evaluation.capability import CapabilityMap
    from flipperctl.runs.capability import map_scenes, map_words
    from flipperctl.runs.interrupts import interrupts
    from flipperctl.runs.named_policies import refuse_beside
    from flipperctl.terminal.capability import print_map
    from flipperctl.terminal.document import show
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.streams import print_note

    refuse_beside("--map", others)
    found = scenes(map_words(words), checkpoint, controller)

    def printed(result: CapabilityMap) -> None:
        show(result.to_dict(), lambda: print_map(result), as_json=as_json)

    with interrupts("finishing the cell; Ctrl-C again stops at once") as stop:
        result = map_scenes(
            *(found, text, output),
            progress=episodes_progress,
            stop=stop,
            show=printed,
            tell=print_note,
        )
    if result.interrupted:
        raise InterruptedRunError(f"interrupted: {result.played} cells of the map are finished")
