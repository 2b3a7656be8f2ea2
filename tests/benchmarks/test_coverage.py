"""How often the intervals contain the truth."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import coverage
from benchmarks.coverage import main, mean_coverage, paired_coverage, rate_coverage


@pytest.mark.parametrize("count", [5, 10, 100])
def test_the_interval_of_a_normal_mean_contains_it_in_95_percent(count: int) -> None:
    rng = np.random.default_rng(7)
    found = mean_coverage(2.0, lambda rng, shape: rng.normal(2.0, 3.0, shape), count, 3000, rng)
    assert found == pytest.approx(0.95, abs=0.012)  # three standard errors of 3,000 samples


def test_a_skewed_mean_is_covered_less_often() -> None:
    rng = np.random.default_rng(7)
    found = mean_coverage(1.0, lambda rng, shape: rng.exponential(size=shape), 5, 3000, rng)
    assert 0.86 < found < 0.90
    assert math.isnan(mean_coverage(0.0, lambda rng, s: rng.normal(size=s), 3, 10, rng))


def test_rates_are_covered_as_their_outcomes_say() -> None:
    # All of 0 to 2 of 2 but one end: of a rate of 0.5 each interval contains it.
    assert rate_coverage(0.5, 2) == 1.0
    # Of 5, the intervals of 1 to 4 contain 0.5, those of 0 and 5 do not: 1 − 2 / 32.
    assert rate_coverage(0.5, 5) == pytest.approx(30 / 32)


@pytest.mark.parametrize(("won", "lost"), [(0.0, 0.0), (0.1, 0.02), (0.3, 0.3), (0.5, 0.2)])
def test_a_paired_difference_is_covered_in_93_percent_or_more(won: float, lost: float) -> None:
    for total in (5, 10, 20, 40):
        assert 0.93 <= paired_coverage(won, lost, total) <= 1.0 + 1e-9


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--repetitions", "0"], "1 or more"),
        (["--seed", "-1"], "0 or more"),
        (["missing.csv"], "missing.csv"),
        (["other.csv"], "'outcome'"),
    ],
)
def test_what_is_wrong_is_named(
    arguments: list[str],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert word in capsys.readouterr().err


def test_the_command_adds_recorded_episodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coverage, "COUNTS", (3, 20))
    path, rng = tmp_path / "episodes.csv", np.random.default_rng(1)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        names = ("scene", "controller", "seed", "outcome", "pitch_variation_100hz")
        writer.writerow((*names, "conditions_hash"))
        for seed in range(30):
            for who in ("okada", "level", "best known (okada)"):
                outcome = "stuck" if seed == 3 else "reached"
                writer.writerow(("stair", who, seed, outcome, rng.normal(2, 0.1), "abcd"))
    main([str(path), "--repetitions", "300"])
    lines = capsys.readouterr().out.splitlines()
    assert not any("best known" in line for line in lines)  # its episodes are those of okada
    for name in ("stair abcd, okada", "stair abcd, level", "stair abcd, okada - level"):
        (line,) = (line for line in lines if line.startswith(f"{name}  "))
        assert line.split()[-2] == "-"
        assert 90 <= float(line.split()[-1].rstrip("%")) <= 99
