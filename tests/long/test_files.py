"""Some hundred damaged files of each kind; ``python -m tests.long.files`` runs thousands."""

import os
import signal
import time
import warnings

import pytest

from flipperctl.errors import CheckpointError, ExportError
from tests.long.files import BAD, KINDS, fuzz
from tests.long.isolated import run_isolated

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_or_read_as_the_original(kind: str) -> None:
    with fuzz(kind, seed=0) as found:
        verdicts = list(found.run(120))
    assert len(verdicts) == 120
    assert [v for v in verdicts if v[1][0] in BAD] == []
    assert sum(verdict == "refused" for _, (verdict, _) in verdicts) > 40


def _misbehave(case: int) -> str:
    if case == 1:
        raise CheckpointError("it is damaged")
    if case == 2:
        raise KeyError("a")
    if case == 3:
        raise ExportError("of exit code 1")
    if case == 4:
        warnings.warn("odd", stacklevel=1)
    if case == 5:
        os.write(1, b"*** EP Error ***")
    if case == 6:
        time.sleep(60)
    if case == 7:
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)  # not pytest's handler, which prints
        os.kill(os.getpid(), signal.SIGSEGV)
    if case == 8:
        bytearray(1 << 40)
    return "equal"


def test_every_kind_of_violation_is_found() -> None:
    verdicts = [verdict for verdict, _ in run_isolated(10, _misbehave, limit=1.0)]
    expected = ["equal", "refused", "traceback", "traceback", "traceback", "noise", "hang"]
    assert verdicts == [*expected, "traceback", "traceback", "equal"]
