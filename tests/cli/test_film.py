"""``flipperctl eval --film``."""

from pathlib import Path

import pytest

from tests.cli.call import call


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["terrain=step,stair", "--film", "film.gif"], "--film shows one scene; 2 are evaluated"),
        (["terrain=step", "--film", "film.mp4"], "a film is a .gif file; the suffix is '.mp4'"),
    ],
)
def test_an_impossible_film_is_refused_before_any_episode(
    arguments: list[str], reason: str, tmp_path: Path
) -> None:
    done = call("eval", "level", *arguments, cwd=tmp_path)
    assert done.code == 2
    assert reason in done.err
    assert list(tmp_path.iterdir()) == []


def test_a_shipped_policy_is_called_by_its_name(tmp_path: Path) -> None:
    done = call(
        "eval", "generalist", "terrain=flat", "terrain.length=0.2", "--episodes", "1",
        "--film", "film.gif", "--json", cwd=tmp_path,
    )  # fmt: skip
    assert done.code == 0, done.err
    assert '"controller": "generalist"' in done.out
    assert "wrote film.gif\n" in done.err
    assert (tmp_path / "film.gif").read_bytes().startswith(b"GIF89a")
