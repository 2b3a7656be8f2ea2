"""A few kills, races and stopped sweeps in one process, which imports torch once for all of them.

``python -m tests.long.few`` exits with the number of the three checks that found a violation.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.long import killed_sweeps, kills, races

SEED = 5


def main() -> None:
    """Run the cases of each check."""
    with TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as name:
        folders = [Path(name) / check for check in ("kills", "races", "sweeps")]
        for folder in folders:
            folder.mkdir()
        codes = (
            kills.run(2, 1, SEED, folders[0], fast=0.0),
            races.run(2, SEED, folders[1], fast=0.0),
            killed_sweeps.run(1, SEED, folders[2], joblib=0.0, stops=["SIGKILL"]),
        )
    sys.exit(sum(code != 0 for code in codes))


if __name__ == "__main__":
    main()
