"""θ̂_R at 100 Hz comes first wherever people read it, and the paper's at decisions beside it."""

from pathlib import Path

from flipperctl.terminal.progress import pitch_variation_text
from tests.cli.call import call


def test_both_are_named() -> None:
    both = {"pitch_variation": 1.125, "pitch_variation_100hz": 1.375}
    assert pitch_variation_text(both, 3) == "θ̂_R 1.375 rad (1.125 at decisions)"


def test_tables_of_eval_have_it_first(tmp_path: Path) -> None:
    options = ["terrain=step", "--episodes", "2", "--baseline", "level"]
    done = call("eval", "okada", *options, "--columns", "pitch_variation", cwd=tmp_path)
    assert done.code == 0, done.err
    heads = done.out.splitlines()[1]
    first, papers = (
        heads.index("pitch variation [rad]"),
        heads.index("variation at decisions [rad]"),
    )
    assert 0 < first < heads.index("time [s]") < papers
    assert "same episodes: pitch variation " in done.out
