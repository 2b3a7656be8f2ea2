"""Commands as processes of their own."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from flipperctl.errors import FlipperctlError, MissingExtraError


def output(command: Sequence[str], what: str) -> str:
    """Run a command to its end; returns what it wrote to stdout.

    Raises:
        MissingExtraError: it left with the code of a wrong request and says what to install.
        FlipperctlError: it failed otherwise; the text gives ``what`` and its last line.
    """
    # What is run is this interpreter with flipperctl's own modules.
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    if done.returncode == 0:
        return done.stdout
    said = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
    if done.returncode == MissingExtraError.exit_code and "install flipperctl[" in said:
        raise MissingExtraError(said.removeprefix("error: "))
    raise FlipperctlError(f"{what} failed: {said}")
