"""``perception=lidar``: the ground by a map that grows from the scans of a LiDAR.

In: settings of the devices, of their places on the robot, and of the map. Out: the instruments that
measure in simulation and the estimator that uses them, ``flipperctl.core.lidar``. Importing this
package registers the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

from pydantic import Field, field_validator, model_validator

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
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import Lidar, MapQuality, MapSettings
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.core.lidar.outline import accuracy_of
from flipperctl.errors import missing_extra
from flipperctl.sim.lidar.instruments import (
    Accelerometer,
    BeltEncoders,
    Encoders,
    InertialUnit,
    RangeErrors,
    Scanner,
    Tracking,
)
from flipperctl.sim.planar.sensing import PlanarSensor

_LEAST_NOISE = 0.01
"""The map takes points for no more accurate than this, because slopes and edges spread them [m]."""


@sensor("lidar")
class LidarSensor(Sensor):
    """Maps the ground by a LiDAR of 32 rings, as in the paper's experiment; the map remembers.

    It needs an engine that casts rays. Errors and angles are a RoboSense RS-Bpearl's.
    """

    not_sampled = Sensor.not_sampled | {"azimuths", "deskew", "pose", "scan_parts"}

    pose: Literal["true", "belts", "matched"] = Field(
        "true",
        description="pose at which scans enter the map: the true one; belts is odometry by belt "
        "speeds and an inertial unit, whose errors and the belts' slip then count; matched "
        "corrects that by matching the scans, with the extra flipperctl[lidar] [-]",
    )
    azimuths: int = Field(
        225,
        ge=8,
        le=1800,
        description="rays of each of the 32 rings in a turn; the RS-Bpearl has 1800 at 10 Hz, of "
        "which the default simulates every eighth, for speed [-]",
    )
    scan_parts: Literal[1, 2, 5, 10] = Field(
        5,
        description="parts in which a turn of 0.1 s is simulated, each from the pose of its "
        "instant; 1 casts all rays at the turn's end [-]",
    )
    deskew: bool = Field(
        True, description="correct the points for the robot's motion during the turn [-]"
    )
    near: float = Field(
        0.1,
        ge=0,
        le=1,
        description="radius of the blind zone; 0.1 by the RS-Bpearl's manual [m]",
    )
    far: float = Field(
        30.0,
        ge=2,
        le=100,
        description="farthest ground that returns; 30 at 10 % reflectivity by the RS-Bpearl's "
        "manual [m]",
    )
    noise: float = Field(
        0.01,
        ge=0,
        le=0.1,
        description="standard deviation of a distance; with range_bias it makes up the ±0.03 "
        "accuracy of the RS-Bpearl's manual [m]",
    )
    range_bias: float = Field(
        0.02,
        ge=0,
        le=0.1,
        description="largest error of all distances of an episode, sampled uniformly from ± this; "
        "it is part of the manual's accuracy [m]",
    )
    resolution: float = Field(
        0.005,
        ge=0,
        le=0.05,
        description="step of the distances; 0.005 in the RS-Bpearl's packets; 0 is none [m]",
    )
    dropout: float = Field(
        0.01, ge=0, le=0.9, description="fraction of the returns that are lost; a guess [-]"
    )
    mixed: float = Field(
        0.1,
        ge=0,
        le=1,
        description="fraction of the returns at depth discontinuities that lie between the two "
        "surfaces; assumed: a beam of 5 mrad, 28 mrad between two azimuths by default, and returns "
        "on both sides of the edge [-]",
    )
    mixed_gap: float = Field(
        1.0,
        ge=0,
        le=10,
        description="largest distance of two surfaces whose returns mix; by its manual, the "
        "RS-Bpearl tells returns apart that are over 1 m apart [m]",
    )
    grazing: float = Field(
        1.4,
        ge=0.8,
        le=2,
        description="angle of incidence at which half of the returns are lost; assumed, since the "
        "literature has errors that grow from 1.05 on and no figure for losses; 2 loses none [rad]",
    )
    grazing_width: float = Field(
        0.2,
        ge=0.01,
        le=0.5,
        description="range of angles of incidence around grazing within which the lost fraction "
        "rises from 0 to 1; assumed [rad]",
    )
    tilt_wander: float = Field(
        0.003,
        ge=0,
        le=0.1,
        description="standard deviation of the inertial unit's slow error of roll and pitch; "
        "0.2° of static accuracy are usual for such units (not for pose=true) [rad]",
    )
    tilt_noise: float = Field(
        0.001,
        ge=0,
        le=0.1,
        description="standard deviation of the white error of roll and pitch (not for "
        "pose=true) [rad]",
    )
    yaw_rate_bias: float = Field(
        0.0005,
        ge=0,
        le=0.05,
        description="standard deviation of the constant error of an episode's yaw rate, which "
        "is left after a calibration at rest (not for pose=true) [rad/s]",
    )
    yaw_rate_noise: float = Field(
        0.005,
        ge=0,
        le=0.1,
        description="standard deviation of a yaw rate at 100 Hz (not for pose=true) [rad/s]",
    )
    accelerometer_noise: float = Field(
        0.05,
        ge=0,
        le=5,
        description="standard deviation of each axis of the specific force at 100 Hz; assumed for "
        "a vehicle that vibrates, units at rest have a tenth (not for pose=true) [m/s²]",
    )
    accelerometer_bias: float = Field(
        0.05,
        ge=0,
        le=1,
        description="standard deviation of the constant error of each axis of the specific force "
        "in an episode; 5 mg, usual for such units (not for pose=true) [m/s²]",
    )
    belt_error: float = Field(
        0.01,
        ge=0,
        le=0.2,
        description="largest relative error of the measured belt speed in an episode, sampled "
        "uniformly from ± this; a guess for worn belts (not for pose=true) [-]",
    )
    mount_x: float = Field(
        0.25,
        ge=-1,
        le=1,
        description="position of the LiDAR ahead of the chassis centre, along the chassis; the "
        "paper says in front, without a number [m]",
    )
    mount_z: float = Field(
        0.4,
        ge=0.12,
        le=2,
        description="height of the LiDAR above the chassis centre; not given in the paper [m]",
    )
    mount_axis: float = Field(
        -math.pi / 4,
        ge=-math.pi / 2,
        le=math.pi / 2,
        description="elevation of the axis of the rings; -π/4 sees dense ground ahead and some "
        "beside the robot; not given in the paper [rad]",
    )
    chassis_width: float = Field(
        0.352, ge=0.1, le=2, description="width of the chassis between the flippers [m]"
    )
    overall_width: float = Field(
        0.712, ge=0.1, le=3, description="width over the outer sides of the flippers [m]"
    )
    filter_margin: float = Field(
        0.05,
        ge=0,
        le=0.3,
        description="points closer than this to the robot's own shape do not enter the map [m]",
    )
    cell: float = Field(
        0.025, ge=0.01, le=0.1, description="length of the map's cells along the way [m]"
    )
    lane: float = Field(0.09, ge=0.02, le=0.5, description="width of the map's cells [m]")
    keep: int = Field(32, ge=4, le=128, description="newest points that a cell holds [-]")
    half_width: float = Field(
        0.36,
        ge=0.1,
        le=1,
        description="ground within this distance beside the robot's line makes up its profile; "
        "the robot is 0.36 wide to each side [m]",
    )
    fewest: int = Field(
        4, ge=1, le=100, description="points without which a column of cells is unseen [-]"
    )

    @field_validator("pose", mode="before")
    @classmethod
    def _word(cls, value: object) -> object:
        return "true" if value is True else value  # as YAML reads pose=true

    @model_validator(mode="after")
    def _flippers_outside(self) -> LidarSensor:
        if self.overall_width <= self.chassis_width:
            raise ValueError(
                f"overall_width ({self.overall_width:g} m) must exceed chassis_width "
                f"({self.chassis_width:g} m), since the flippers are beside the chassis"
            )
        return self

    def instruments(self, mounting: Mounting) -> Mapping[str, Instrument]:
        """Return the instruments of one episode.

        Instruments that measure at the same time are in the order in which they are used.
        """
        rng = mounting.rng
        # The bias is constant during an episode, so it is sampled here and not in a measurement.
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
        # The order in which the estimator uses messages of one time: pose and joints before the
        # scan.
        scanning = {"encoders": Encoders(scanner.period), "lidar": scanner}
        at_decision: dict[str, Instrument] = {"encoders_at_decision": Encoders(None)}
        if self.pose != "true":
            return {**self._odometry(mounting), **scanning, **at_decision}
        at_decision["tracking_at_decision"] = Tracking(None)
        return {"tracking": Tracking(scanner.period), **scanning, **at_decision}

    def _odometry(self, mounting: Mounting) -> dict[str, Instrument]:
        rng, robot = mounting.rng, mounting.robot
        assert isinstance(robot, Robot)  # a RobotGeometry has no speed
        # The order of these draws is part of an episode: equal seeds must give equal errors.
        rate_bias = self.yaw_rate_bias * float(rng.standard_normal())
        belts = BeltEncoders(robot.track_speed, self.belt_error * rng.uniform(-1.0, 1.0))
        tilt, rate = (self.tilt_wander, self.tilt_noise), (self.yaw_rate_noise, rate_bias)
        unit = InertialUnit(*tilt, *rate, rng)
        bias = self.accelerometer_bias * rng.standard_normal(3)
        force = Accelerometer(self.accelerometer_noise, bias, mounting.gravity)
        return {"belts": belts, "inertial": unit, "accelerometer": force}

    def estimator(self, robot: RobotGeometry) -> Estimator:
        """Return a new estimator for the nominal ``robot``.

        Raises:
            MissingExtraError: ``pose`` is ``matched``, and small_gicp is not installed.
        """
        accuracy = accuracy_of(self.pose, self.range_bias, self._tilt_error)
        shape = self.bins, self.bin_width, self.highest
        settings = MapSettings(*shape, self._quality, accuracy, self.sides)
        try:
            matcher = ScanMatcher() if self.pose == "matched" else None
        except ImportError as error:
            raise missing_extra("perception.pose=matched", "small_gicp") from error
        return LidarEstimator(self._body(robot), self._mount, settings, matcher)

    def exact(self) -> PlanarSensor:
        """Return the sensor of the true ground."""
        return PlanarSensor(**self.layout.model_dump())

    @property
    def lidar(self) -> Lidar:
        """What the robot's controller has to know of the LiDAR and its map."""
        return Lidar(
            quality=self._quality,
            mount=self._mount,
            chassis_width=self.chassis_width,
            overall_width=self.overall_width,
            range_bias=self.range_bias,
            tilt_error=self._tilt_error,
        )

    @property
    def _tilt_error(self) -> float:
        # The slow and the white error of the tilt are independent, so their variances add.
        return math.hypot(self.tilt_wander, self.tilt_noise)

    @property
    def _quality(self) -> MapQuality:
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
