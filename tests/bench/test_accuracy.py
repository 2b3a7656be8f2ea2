"""Substeps against finer ones."""

from flipperctl.bench import accuracy
from tests.bench.small import check, check_ratio, small_bench


def test_each_substep_is_compared_with_the_finest() -> None:
    found = accuracy.measure(small_bench(starts=2))
    check(found)
    assert len(found["quantities"]) == 2 * 2 * 4
    for scene in ("paper_step", "paper_stair", "paper_step.100hz", "paper_stair.100hz"):
        coarse, finest = f"{scene}.5ms", f"{scene}.1.25ms"
        check_ratio(found, f"{coarse} / {finest}", coarse, finest)
        # Another substep gives another trajectory with nearly the same θ̂_R.
        values = [found["quantities"][name]["values"] for name in (coarse, finest)]
        assert values[0] != values[1]
        assert 0.9 < found["ratios"][f"{coarse} / {finest}"]["ratio"] < 1.1
