"""What the controller takes in, its estimator can use."""

from flipperctl.core.lidar.messages import Belts, Inertial, checked
from flipperctl.runtime import intake


def test_what_passes_the_intake_passes_the_estimator() -> None:
    assert checked(0.0, Belts(intake._FASTEST)) is not None
    assert checked(0.0, Inertial(0.0, 0.0, intake._FASTEST_TURN)) is not None
