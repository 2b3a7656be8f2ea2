"""Run commands as separate processes."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from flipperctl.errors import FlipperctlError, MissingExtraError
from flipperctl.rollout.children import python_environment


def output(command: Sequence[str], what: str) -> str:
    """Run a command to its end and return its stdout.

    Raises:
        MissingExtraError: the command failed because an extra is not installed.
        FlipperctlError: the command failed otherwise; the text has ``what`` and its last line.
    """
    # All callers run this interpreter with flipperctl's own modules.
    done = subprocess.run(  # noqa: S603
        command, env=python_environment(), capture_output=True, text=True, check=False
    )
    if done.returncode == 0:
        return done.stdout
    reason = (done.stderr.strip().splitlines() or ["it wrote no message"])[-1]
    if done.returncode == MissingExtraError.exit_code and "install flipperctl[" in reason:
        raise MissingExtraError(reason.removeprefix("error: "))
    raise FlipperctlError(f"{what} failed: {reason}")
