"""``flipperctl eval --replay``: a recorded episode once more."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def run_replay(
    file: Path,
    checkpoint: Path | None,
    output: Path | None,
    film: Path | None,
    *,
    as_json: bool,
    others: dict[str, Any],
) -> None:
    """Play the episode, print whether it is the recorded one, and draw it.

    ``others`` are options that a replay does not take.

    Raises:
        RequestError: one of the ``others`` is given, or the episode cannot be played here.
        FlipperctlError: the episode differs from the recorded one.
    """
    from flipperctl.errors import FlipperctlError
    from flipperctl.runs.named_policies import refuse_beside
    from flipperctl.runs.replay import replay_file
    from flipperctl.terminal.document import show
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.replay import print_replay
    from flipperctl.terminal.streams import print_note

    refuse_beside("--replay", others)
    found = replay_file(file, checkpoint, output, film, progress=episodes_progress, tell=print_note)
    show(found.to_dict(), lambda: print_replay(found), as_json=as_json)
    if found.differences:
        raise FlipperctlError(
            f"{file}: the episode differs from the recorded one: {'; '.join(found.differences)}"
        )
