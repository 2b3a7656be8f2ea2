"""``perception=lidar``: the ground by a map that grows from the scans of a LiDAR.

In: settings. Out: the instruments that measure in simulation and the estimator that uses them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from flipperctl.api import (
    Estimator,
    Instrument,
    Mounting,
    Robot,
    RobotGeometry,
    Sensor,
    sensor,
)
from flipperctl.core.lidar.body import Body, Mount
from flipperctl.core.lidar.certainty import Accuracy, accuracy_of
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.errors import MissingExtraError
from flipperctl.sim.lidar.instruments import (
    Accelerometer,
    BeltEncoders,
    Encoders,
    InertialErrors,
    InertialUnit,
    Tracking,
)
from flipperctl.sim.lidar.scanner import RangeErrors, Scanner
from flipperctl.sim.lidar.settings import LidarSettings
from flipperctl.sim.planar.sensing import PlanarSensor

_LEAST_NOISE = 0.01
"""The map takes points for no more accurate than this, because slopes and edges spread them [m]."""


@sensor("lidar")
class LidarSensor(LidarSettings, Sensor):
    """Maps the ground by a LiDAR of 32 rings, as in the paper's experiment; the map remembers.

    It needs an engine that casts rays. Errors and angles are those of a RoboSense RS-Bpearl.
    """

    not_sampled = Sensor.not_sampled | {"azimuths", "deskew", "pose", "scan_parts"}

    def instruments(self, mounting: Mounting) -> Mapping[str, Instrument]:
        """Return the instruments of one episode, those of one time in the order of use."""
        rng = mounting.rng
        errors = RangeErrors(
            noise=self.noise,
            bias=self.range_bias * rng.uniform(-1.0, 1.0),
            resolution=self.resolution,
            dropout=self.dropout,
            mixed=self.mixed,
            mixed_gap=self.mixed_gap,
            grazing=self.grazing,
            grazing_width=self.grazing_width,
        )
        body = self._body(mounting.robot)
        scanner = Scanner(
            self.azimuths, self.far, errors, self._mount, body, mounting.rays, self.scan_parts
        )
        scanning = {"encoders": Encoders(scanner.period), "lidar": scanner}
        at_decision: dict[str, Instrument] = {"encoders_at_decision": Encoders(None)}
        if self.pose != "true":
            return {**self._odometry(mounting), **scanning, **at_decision}
        at_decision["tracking_at_decision"] = Tracking(None)
        return {"tracking": Tracking(scanner.period), **scanning, **at_decision}

    def _odometry(self, mounting: Mounting) -> dict[str, Instrument]:
        rng, robot = mounting.rng, mounting.robot
        assert isinstance(robot, Robot)  # a RobotGeometry has no speed
        errors = InertialErrors(
            tilt_wander=self.tilt_wander,
            tilt_noise=self.tilt_noise,
            yaw_rate_noise=self.yaw_rate_noise,
            yaw_rate_bias=self.yaw_rate_bias * float(rng.standard_normal()),
        )
        belts = BeltEncoders(robot.track_speed, self.belt_error * rng.uniform(-1.0, 1.0))
        unit = InertialUnit(errors, rng)
        bias = self.accelerometer_bias * rng.standard_normal(3)
        force = Accelerometer(self.accelerometer_noise, bias, mounting.gravity)
        return {"belts": belts, "inertial": unit, "accelerometer": force}

    def estimator(self, robot: RobotGeometry) -> Estimator:
        """Return a new estimator for the nominal ``robot``.

        Raises:
            MissingExtraError: ``pose`` is ``matched``, and small_gicp is not installed.
        """
        quality = self.map_quality
        settings = quality.settings(self.bins, self.bin_width, self._accuracy, sides=True)
        matcher = self._matcher() if self.pose == "matched" else None
        return LidarEstimator(self._body(robot), self._mount, settings, matcher, quality.deskew)

    def _matcher(self) -> ScanMatcher:
        try:
            return ScanMatcher()
        except ImportError as error:
            raise MissingExtraError(
                "perception.pose=matched needs small_gicp, which is not installed; "
                "run pip install 'flipperctl[lidar]'"
            ) from error

    def exact(self) -> PlanarSensor:
        """Return the sensor of the true ground."""
        return PlanarSensor(**self.layout.model_dump())

    @property
    def map_quality(self) -> MapQuality:
        """Settings of the map, which exported files state for the robot's controller."""
        return MapQuality(
            cell=self.cell,
            lane=self.lane,
            keep=self.keep,
            half_width=self.half_width,
            fewest=self.fewest,
            noise=max(_LEAST_NOISE, self.noise),
            deskew=self.deskew,
        )

    @property
    def _accuracy(self) -> Accuracy:
        tilt = math.hypot(self.tilt_wander, self.tilt_noise)
        return accuracy_of(self.pose, self.range_bias, tilt)

    @property
    def _mount(self) -> Mount:
        return Mount(self.mount_x, self.mount_z, self.mount_axis, self.near, self.filter_margin)

    def _body(self, robot: RobotGeometry) -> Body:
        return Body(
            chassis_length=robot.chassis_length,
            flipper_length=robot.flipper_length,
            track_radius=robot.track_radius,
            chassis_width=self.chassis_width,
            overall_width=self.overall_width,
        )
