"""The lines of ``flipperctl eval --replay``."""

from __future__ import annotations

from flipperctl.evaluation.replay import Replay
from flipperctl.evaluation.rows import DIGEST
from flipperctl.runs.replay import title
from flipperctl.terminal.console import console, print_lines


def print_replay(found: Replay) -> None:
    """Print outcome and measures of the episode, and whether it is bit-identical."""
    episode = found.episode
    lines = [
        title(found),
        f"{episode['decisions']} decisions, {episode['t_cost']:.2f} s, pitch variation "
        f"{episode['pitch_variation_100hz']:.3f} rad, largest pitch {episode['max_pitch']:.3f} rad",
    ]
    if found.record.digest is None and not found.differences:
        lines.append("equal to the recorded episode by its measures; it has no digest of the poses")
    elif not found.differences:
        lines.append(f"bit-identical to the recorded episode, digest {episode[DIGEST]:.16}…")
    print_lines(console(), lines)
