"""A list that names something twice is refused, whichever option takes it."""

from pathlib import Path

import pytest

from tests.cli.call import call


@pytest.mark.parametrize(
    "words",
    [
        ("eval", "--controller", "okada", "terrain=stair,stair"),
        ("eval", "--controller", "okada", "terrain=stair", "conditions=nominal,nominal"),
        ("eval", "--controller", "okada", "terrain=stair", "--baseline", "level, level"),
        ("eval", "--controller", "okada", "terrain=stair", "--passable", "level,level"),
        ("eval", "--controller", "okada", "terrain=stair", "--by", "steps,steps"),
        ("eval", "--controller", "okada,level", "--baseline", "mpc,mpc", "terrain=stair"),
        ("train", "-m", "terrain=flat", "seed=1,1"),
    ],
)
def test_a_list_with_a_name_twice_is_refused(words: tuple[str, ...], tmp_path: Path) -> None:
    done = call(*words, cwd=tmp_path)
    assert done.code == 2
    assert "is given twice; once is allowed" in done.err
    assert len(done.err.splitlines()) == 1
