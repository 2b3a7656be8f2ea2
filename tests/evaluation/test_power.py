"""Numbers of episodes that show a difference."""

import pytest

from flipperctl.evaluation import intervals
from flipperctl.evaluation.power import (
    paired_episodes,
    paired_power,
    success_episodes,
    success_power,
)


def test_the_power_of_mcnemars_test_is_the_probability_that_it_rejects() -> None:
    # With 7 pairs that are all unequal, the test rejects 0 of 7 and 7 of 7 alone (p = 0.016;
    # 1 of 7 has p = 0.125). At rates 0.9 and 0.1 that is 0.9^7 + 0.1^7.
    assert intervals.mcnemar_p(6, 1) > 0.05 > intervals.mcnemar_p(7, 0)
    assert success_power(0.9, 0.1, 7) == pytest.approx(0.9**7 + 0.1**7)
    # Five pairs can never reject: 5 of 5 has p = 0.0625.
    assert success_power(1.0, 0.0, 5) == 0.0
    assert success_power(1.0, 0.0, 6) == 1.0
    assert success_power(0.0, 0.0, 50) == 0.0


def test_the_number_of_episodes_is_the_smallest_that_suffices() -> None:
    found = paired_episodes(0.1, 0.5)
    assert found == 199  # (1.96 + 0.84)² · 25 = 196, and three more since s is estimated
    assert paired_power(0.1, 0.5, found) >= 0.8 > paired_power(0.1, 0.5, found - 1)
    assert paired_episodes(0.1, 0.0) == 2
    assert paired_episodes(1e-6, 1.0) is None
    with pytest.raises(ValueError, match="0"):
        paired_episodes(0.0, 1.0)


def test_success_needs_six_pairs_if_only_one_ever_succeeds() -> None:
    assert success_episodes(1.0, 1.0) == 6
    few = success_episodes(0.05, 0.05)
    many = success_episodes(0.05, 0.2)
    assert few is not None
    assert many is not None
    assert few < many
    with pytest.raises(ValueError, match=r"1\.5"):
        success_episodes(1.5, 0.1)
