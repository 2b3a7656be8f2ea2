"""The turn of the heading from the rates of a robot that leans."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flipperctl.runtime import Attitude


@pytest.mark.parametrize(
    ("roll", "pitch", "rates"),
    [
        (0.0, 0.0, (0.3, -0.2, 0.5)),
        (0.14, 0.0, (0.0, -0.5, 0.0)),  # it leans and lifts its nose: no turn about z alone
        (0.2, -0.6, (0.1, 0.2, -0.3)),
        (-0.3, 0.7, (0.0, 0.4, 0.4)),
    ],
)
def test_the_rates_about_its_axes_give_the_turn_of_its_heading(
    roll: float, pitch: float, rates: tuple[float, float, float]
) -> None:
    now = Rotation.from_euler("ZYX", [0.4, pitch, roll])
    told = Attitude.from_imu(0.0, "base_link", tuple(now.as_quat()), rates)
    step = 1e-6
    later = now * Rotation.from_rotvec(step * np.array(rates))
    turn = (later.as_euler("ZYX")[0] - now.as_euler("ZYX")[0]) / step
    assert told.yaw_rate == pytest.approx(turn, abs=1e-5)
    assert told.pitch == pytest.approx(pitch)  # nose down positive


def test_a_unit_on_end_or_without_orientation_gives_no_infinite_turn() -> None:
    half = math.sqrt(0.5)
    upright = Attitude.from_imu(0.0, "base_link", (0.0, half, 0.0, half), (1.0, 1.0, 1.0))
    assert math.isfinite(upright.yaw_rate)
    none = Attitude.from_imu(0.0, "base_link", (0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    assert math.isnan(none.roll)
