"""The estimator of ``perception=lidar`` for a robot, from the file of its policy.

In: an interface and the robot's devices. Out: a ``LidarEstimator`` that knows nothing yet.
"""

from __future__ import annotations

from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.certainty import accuracy_of
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.errors import MissingExtraError, PolicyError
from flipperctl.runtime.interface import Interface
from flipperctl.runtime.setup import RobotSetup

_LENGTHS = "chassis_length", "flipper_length", "track_radius"


def new_estimator(interface: Interface, setup: RobotSetup, *, level: bool = True) -> LidarEstimator:
    """Return a new estimator with the bins and the map of the policy and the lengths of its robot.

    ``level``: whether the robot stands on level ground now.

    A policy whose file states no map, as of a training without a LiDAR, gets the default one.

    Raises:
        PolicyError: the file states no lengths of its robot.
        MissingExtraError: scans shall be matched, and small_gicp is not installed.
    """
    missing = [name for name in _LENGTHS if name not in interface.robot]
    if missing:
        raise PolicyError(f"the policy's file does not state robot.{missing[0]}; export it again")
    body = Body(
        **{name: float(interface.robot[name]) for name in _LENGTHS},
        chassis_width=setup.chassis_width,
        overall_width=setup.overall_width,
    )
    quality = interface.map_quality or MapQuality()
    settings = quality.settings(
        interface.bins,
        interface.bin_width,
        accuracy_of(setup.pose, setup.range_bias, setup.tilt_error),
        sides=False,  # no policy takes them
    )
    return LidarEstimator(body, setup.mount, settings, _matcher(setup), quality.deskew, level=level)


def _matcher(setup: RobotSetup) -> ScanMatcher | None:
    if setup.pose != "matched":
        return None
    try:
        return ScanMatcher()
    except ImportError as error:
        raise MissingExtraError(
            "pose='matched' needs small_gicp, which is not installed; run pip install small_gicp"
        ) from error
