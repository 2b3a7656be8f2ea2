"""The file of a policy that a command was asked for, and a word if no validation chose it."""

from __future__ import annotations

import sys
from pathlib import Path

from flipperctl import checkpoint as checkpoints


def find_policy(run_or_file: Path) -> Path:
    """Return the file of a run's best policy, a file, or the name of a shipped policy.

    Before a run's first validation there is no best policy; then the last checkpoint is returned,
    and a line on stderr says so.

    Raises:
        CheckpointError: there is no such checkpoint.
    """
    file = checkpoints.find(run_or_file)
    if run_or_file.is_dir() and file == run_or_file / checkpoints.LAST:
        print(
            f"{run_or_file}: no validation has chosen a best policy yet; this is the last one, "
            f"{checkpoints.LAST}",
            file=sys.stderr,
        )
    return file
