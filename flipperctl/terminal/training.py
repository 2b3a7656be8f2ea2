"""What a training prints: its progress, its best validation, and what to type next.

In: the reports of a training, and a finished run. Out: lines on stderr.
"""

from __future__ import annotations

from flipperctl.runs.follow_up import command
from flipperctl.runs.training import Finished, Reports
from flipperctl.terminal.pitch_variation import swing_text
from flipperctl.terminal.progress import progress
from flipperctl.terminal.streams import print_note


def reports() -> Reports:
    """Return the reports that show a training on stderr."""
    return Reports([progress], print_note)


def print_best(run: Finished) -> None:
    """Print the best validation of a run that was trained now, and the commands to use it."""
    if not run.trained:
        return
    best = run.summary["best"]
    print_note(
        f"\nBest validation at decision {best['decision']}: success {best['success_rate']:.0%}, "
        f"{swing_text(best, 2)}, {best['t_cost']:.1f} s. "
        f"{run.summary['decisions']} decisions in {run.summary['seconds']:.0f} s.\n"
        f"Evaluate: {command('eval', '--checkpoint', run.directory)}\n"
        f"Export:   {command('export', 'onnx', '--checkpoint', run.directory)}"
    )
