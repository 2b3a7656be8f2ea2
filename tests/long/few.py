"""A few kills, races, stopped sweeps and hostile folders in one process, which imports torch once.

``python -m tests.long.few`` exits with the number of the four checks that found a violation.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.long import hostile, killed_sweeps, kills, races

SEED = 5


def main() -> None:
    """Run the cases of each check."""
    with TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as name:
        folders = [Path(name) / check for check in ("kills", "races", "sweeps", "hostile")]
        for folder in folders:
            folder.mkdir()
        codes = (
            kills.run(2, 1, SEED, folders[0], fast=0.0),
            races.run(2, SEED, folders[1], fast=0.0),
            killed_sweeps.run(1, SEED, folders[2], joblib=0.0, stops=["SIGKILL"]),
            hostile.run(2, SEED, folders[3]),
        )
    sys.exit(sum(code != 0 for code in codes))


if __name__ == "__main__":
    main()
