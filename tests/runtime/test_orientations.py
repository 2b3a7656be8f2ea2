"""A controller refuses an orientation that no one fills in."""

import pytest

from flipperctl.runtime.intake import Intake
from flipperctl.runtime.messages import Attitude
from flipperctl.runtime.setup import Limits, RobotSetup


def received(turns, rate):
    """The faults after each message of a unit at 100 Hz."""
    intake = Intake(RobotSetup(), Limits())
    for tick, turn in enumerate(turns):
        time = 1 + 0.01 * tick
        message = Attitude.from_imu(time, "base_link", turn, (0.0, rate, 0.0))
        list(intake.receive(time, attitude=message))
        yield intake.refused("attitude")


LEVEL, UP = (0.0, 0.0, 0.0, 1.0), (0.0, -0.1, 0.0, 0.99498744)


def test_level_while_the_rates_tilt_is_refused_from_then_on():
    faults = list(received([LEVEL] * 40 + [UP, LEVEL], 0.3))
    assert faults[0] is None
    assert faults[39].name == "attitude_unset"
    assert "is level in every message while its rates tilt" in faults[39].reason
    assert faults[40] is None  # it is told at last
    assert faults[41].name == "attitude_unset"


@pytest.mark.parametrize("rate", [0.0, 0.02])
def test_a_robot_on_level_ground_is_not(rate):
    assert set(received([LEVEL] * 300, rate)) == {None}
