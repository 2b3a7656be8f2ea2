"""A few hundred spoilt files of each kind; ``python -m tests.long.files`` spoils thousands."""

import pytest

from tests.long.files import BAD, KINDS, fuzz


@pytest.mark.parametrize("kind", KINDS)
def test_spoilt_files_are_refused_or_read_as_what_they_were(kind: str) -> None:
    with fuzz(kind, seed=0) as found:
        verdicts = list(found.run(120))
    assert len(verdicts) == 120
    assert [v for v in verdicts if v[1][0] in BAD] == []
    assert sum(verdict == "refused" for _, (verdict, _) in verdicts) > 40
