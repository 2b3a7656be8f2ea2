"""What no policy file states: the robot, its devices, widths and signs, and what is safe.

In: numbers of the builder. Out: frozen settings, checked: which inputs count, and when the
controller holds and stops; the estimator of ``perception=lidar`` for that robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Literal

from flipperctl.core.lidar.body import Body, Mount
from flipperctl.core.lidar.certainty import accuracy_of
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality, MapSettings
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.errors import MissingExtraError, PolicyError
from flipperctl.runtime.interface import Interface
from flipperctl.runtime.messages import OURS, Signs


@dataclass(frozen=True)
class RobotSetup:
    """What the policy's file does not state of the robot: its devices, widths and signs."""

    signs: Signs = OURS
    """The robot's conventions."""
    cloud_frame: str = "lidar"
    """Frame in which clouds must come."""
    attitude_frame: str = "base_link"
    """Frame whose attitude must come: fixed to the chassis, x ahead, y to the left, z up."""
    mount: Mount = field(default_factory=lambda: Mount(0.25, 0.4, -math.pi / 4, 0.1, 0.05))
    """Where the frame of the clouds is on the robot.

    Clouds that come in the frame of the chassis have the mount ``Mount(0, 0, math.pi / 2, …)``.
    """
    chassis_width: float = 0.352
    """Width of the chassis between the flippers [m]."""
    overall_width: float = 0.712
    """Width over the outer sides of the flippers [m]."""
    pose: Literal["belts", "matched"] = "belts"
    """How scans enter the map: by odometry, or corrected by matching (needs small_gicp)."""
    range_bias: float = 0.02
    """Largest constant error of the LiDAR's distances [m]."""
    tilt_error: float = 0.0032
    """Standard deviation of the inertial unit's roll and pitch [rad]."""


@dataclass(frozen=True)
class Ages:
    """Oldest measurements that a decision may use [s]."""

    cloud: float = 0.5
    """A LiDAR at 10 Hz may lose four scans."""
    attitude: float = 0.1
    """An inertial unit at 100 Hz may lose ten."""
    joints: float = 0.1
    """Encoders at 50 Hz may lose five."""
    odometry: float = 0.3
    """Belt speeds; they count only if they were ever received."""


@dataclass(frozen=True)
class Limits:
    """What the controller takes for safe."""

    ages: Ages = field(default_factory=Ages)
    """Oldest measurements."""
    ahead: float = 0.05
    """Time by which a stamp may lie ahead of the clock [s]."""
    clock_jump: float = 1.0
    """Pause between two steps that counts as a jump of the clock [s]."""
    coverage: float = 0.3
    """Least share of the bins in which ground was seen or stood on [-]."""
    tilt: float = math.radians(55)
    """Largest roll or pitch, both ways; beyond it the belts stop at once [rad]."""
    stop_after: float = 1.0
    """Time for which flippers are held before the belts stop too [s]."""
    standby_speed: float = 0.02
    """Speed of the belts ahead below which the flippers stand by [m/s]."""
    standby_after: float = 0.5
    """Time of such a speed after which they do; one at the start counts at once [s]."""
    standby_until: float = 0.3
    """Time of a larger speed after which the flippers stand by no longer [s]."""
    stall_error: float = 0.12
    """Angle by which a flipper may miss its target for long [rad]."""
    stall_time: float = 2.0
    """Time without approach after which such a flipper counts as stalled [s]."""
    stall_hold: float = 1.0
    """Time for which a stalled flipper is held where it is [s]."""

    def __post_init__(self) -> None:
        """Refuse numbers that are not positive and finite."""
        for part in (self, self.ages):
            for entry in fields(part):
                value = getattr(part, entry.name)
                if isinstance(value, Ages):
                    continue
                if not (isinstance(value, int | float) and 0 < value < math.inf):
                    raise PolicyError(
                        f"limits: {entry.name} is {value!r}; a finite number above 0 is allowed"
                    )


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
    settings = MapSettings(
        interface.bins,
        interface.bin_width,
        interface.map_quality or MapQuality(),
        accuracy_of(setup.pose, setup.range_bias, setup.tilt_error),
    )
    try:
        matcher = ScanMatcher() if setup.pose == "matched" else None
    except ImportError as error:
        raise MissingExtraError(
            "pose='matched' needs small_gicp, which is not installed; run pip install small_gicp"
        ) from error
    return LidarEstimator(body, setup.mount, settings, matcher, level=level)
