"""The simulator that policies look ahead with."""

import pytest

from flipperctl.env.flipper_env import FlipperEnv


def test_progress_is_reported_by_its_new_and_by_its_old_name() -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    reported: list[float] = []
    simulator = env.simulator(reported.append)
    simulator.report_progress(0.25)
    with pytest.warns(DeprecationWarning, match=r"tell is deprecated .* use report_progress"):
        simulator.tell(0.5)
    assert reported == [0.25, 0.5]
