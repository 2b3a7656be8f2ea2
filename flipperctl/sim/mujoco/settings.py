"""The fields of ``sim=mujoco``."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from flipperctl.api import SAMPLE_PERIOD, Settings


class MujocoSettings(Settings):
    """Solver, ground, tracks and steering of the robot in 3-D."""

    substep: float = Field(
        0.005, gt=0.0004, le=0.005, description="time step; 0.01 is a whole multiple of it [s]"
    )
    gravity: float = Field(9.81, gt=0, le=30, description="downward acceleration [m/s²]")
    friction: float = Field(
        1.0,
        gt=0,
        le=10,
        description="friction between track and ground; not given in the paper [-]",
    )
    strip_width: float = Field(
        0.2,
        ge=0.02,
        le=1,
        description="width of the strips that a recorded surface consists of near the robot [m]",
    )
    main_track_offset: float = Field(
        0.086, ge=0.05, le=1, description="middle of each main track beside the chassis centre [m]"
    )
    flipper_offset: float = Field(
        0.266, ge=0.05, le=2, description="middle of each flipper beside the chassis centre [m]"
    )
    track_width: float = Field(0.18, ge=0.02, le=0.5, description="width of every track [m]")
    heading_gain: float = Field(
        2.0,
        ge=0,
        le=20,
        description="difference of the belt speeds for each rad of heading error, as a fraction "
        "of the speed; steers as an operator does; 0 does not steer [1/rad]",
    )
    roll_limit: float = Field(
        math.pi / 3,
        ge=0.1,
        le=math.pi / 2,
        description="absolute roll from which the robot is overturned [rad]",
    )
    lateral_slope: float = Field(
        0.0, ge=-0.6, le=0.6, description="sideways slope of the ground, left up positive [rad]"
    )
    yaw: float = Field(
        0.0,
        ge=0,
        le=0.7,
        description="initial heading, sampled uniformly from ± this angle [rad]",
    )
    offset: float = Field(
        0.0,
        ge=0,
        le=1,
        description="initial sideways shift, sampled uniformly from ± this distance [m]",
    )
    roughness: float = Field(
        0.0,
        ge=0,
        le=0.1,
        description="change in height of each patch of ground, uniform within ± this height [m]",
    )
    one_sided: float = Field(
        0.0,
        ge=0,
        le=1,
        description="fraction by which the right side of the obstacle is lowered to the line "
        "between its ends; the line is at least 1 m long, so that a single step becomes an "
        "incline there [-]",
    )
    stagger: float = Field(
        0.0,
        ge=0,
        le=1,
        description="distance by which the obstacle is farther ahead on the right side [m]",
    )
    oblique: float = Field(
        0.0,
        ge=-0.8,
        le=0.8,
        description="angle at which the obstacle's edges lie across the way, farther ahead on the "
        "left positive; along the way the obstacle stays as it is [rad]",
    )
    mirrored: bool = Field(
        False,
        description="whether left and right of the ground are exchanged: those of one_sided, "
        "stagger, oblique, lateral_slope and of a recorded surface [-]",
    )
    scenery: Literal["none", "walls", "posts"] = Field(
        "none",
        description="what stands beside the way on both sides, seen by sensors that cast rays and "
        "in pictures; nothing touches it [-]",
    )
    scenery_distance: float = Field(
        1.5,
        ge=0.5,
        le=20,
        description="distance of the scenery from the middle of the ground [m]",
    )
    camera_height: float = Field(
        0.3,
        ge=0.1,
        le=2,
        description="height of the front and the rear camera above the chassis centre; they are "
        "above the hinges [m]",
    )
    camera_tilt: float = Field(
        0.35, ge=-1, le=1.5, description="angle of the cameras' axes below the chassis' [rad]"
    )
    camera_angle: float = Field(
        1.05, ge=0.2, le=2.5, description="vertical angle of view of the cameras [rad]"
    )
    view: Literal["outside", "front", "rear"] = Field(
        "outside",
        description="what pictures and films show: the robot from outside, or what its front or "
        "rear camera sees [-]",
    )
    variation: int = Field(
        0,
        ge=0,
        le=2**31 - 1,
        description="selects the random yaw, offset and roughness: another number gives others "
        "in the episodes of the same seed [-]",
    )

    @property
    def handed(self) -> float:
        """-1 if the ground is mirrored, else 1 [-]."""
        return -1.0 if self.mirrored else 1.0

    @property
    def slant(self) -> float:
        """Distance by which the obstacle lies farther ahead for each metre to the left [-]."""
        return self.handed * math.tan(self.oblique)

    @model_validator(mode="after")
    def _divides_the_sample(self) -> MujocoSettings:
        ratio = SAMPLE_PERIOD / self.substep
        if abs(ratio - round(ratio)) > 1e-9:
            raise ValueError("substep must divide 0.01 s, the sampling time of the pitch")
        return self

    @model_validator(mode="after")
    def _flippers_outside(self) -> MujocoSettings:
        if self.flipper_offset < self.main_track_offset:
            raise ValueError("flipper_offset must be at least main_track_offset")
        return self
