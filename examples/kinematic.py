"""An engine and a sensor of your own: a robot that follows the ground without any dynamics.

Try it: ``flipperctl eval --controller okada sim=kinematic perception=ruler --plugins
examples/kinematic.py``
"""

import math

import numpy as np
from pydantic import Field

from flipperctl import api


@api.engine("kinematic")
class Kinematic(api.Engine):
    """A chassis whose ends slide along the ground and whose flippers turn freely."""

    slowdown: float = Field(
        0.5, ge=0, le=0.9, description="fraction of the speed lost on a vertical slope [-]"
    )

    def place(self, profile: api.Profile, robot: api.Robot, start: api.Start) -> api.World:
        """Put the robot on the ground."""
        return Sliding(profile, robot, start, self.slowdown)


class Sliding:
    """See ``flipperctl.api.World``."""

    def __init__(
        self, profile: api.Profile, robot: api.Robot, start: api.Start, slowdown: float
    ) -> None:
        self._profile, self._robot, self._slowdown = profile, robot, slowdown
        self._angles = self._targets = np.array([start.front, start.rear])
        self._x, self._time = start.x, 0.0

    @property
    def position(self) -> tuple[float, float]:
        rear, front = (self._profile.height(self._x + s * self._half) for s in (-1, 1))
        return self._x, (rear + front) / 2 + self._robot.track_radius

    @property
    def pitch(self) -> float:
        rear, front = (self._profile.height(self._x + s * self._half) for s in (-1, 1))
        return math.atan2(front - rear, 2 * self._half)

    @property
    def _half(self) -> float:
        return self._robot.hinge_offset

    def command(self, front: float, rear: float) -> None:
        self._targets = np.array([front, rear])

    def advance(self, samples: int, limits: api.Limits = api.NO_LIMITS) -> api.FloatArray:
        poses = []
        for _ in range(samples):
            speed = self._robot.track_speed * (1 - self._slowdown * abs(math.sin(self.pitch)))
            self._x += speed * math.cos(self.pitch) * api.SAMPLE_PERIOD
            turn = self._robot.flipper_speed * api.SAMPLE_PERIOD
            turned = self._angles + np.clip(self._targets - self._angles, -turn, turn)
            self._angles = np.clip(turned, -self._robot.angle_limit, self._robot.angle_limit)
            self._time += api.SAMPLE_PERIOD
            poses.append([*self.position, self.pitch, *self._angles])
            if limits.reached(*self.position, self.pitch):
                break
        return np.array(poses)

    def state(self) -> api.RobotState:
        speed = np.array([self._robot.track_speed, 0.0])
        front, rear = map(float, self._angles)
        return api.RobotState(
            np.array(self.position), self.pitch, front, rear, speed, 0.0, self._time
        )

    def penetration(self) -> float:
        return 0.0

    def save(self) -> tuple[object, ...]:
        return self._x, self._time, self._angles, self._targets

    def load(self, saved: tuple[float, float, api.FloatArray, api.FloatArray]) -> None:
        self._x, self._time, self._angles, self._targets = saved


@api.sensor("ruler")
class Ruler(api.Sensor):
    """Sense the true height at the centre of each bin, without noise."""

    def over(self, profile: api.Profile, margin: float) -> api.GroundSensor:
        """Return a ruler over this profile."""
        return RulerOver(profile, self)


class RulerOver:
    """See ``flipperctl.api.GroundSensor``."""

    def __init__(self, profile: api.Profile, settings: Ruler) -> None:
        bins = np.arange(settings.bins) + 0.5
        self._x, self._profile = bins * settings.bin_width - settings.reach, profile

    def sense(
        self, state: api.RobotState, rng: np.random.Generator
    ) -> tuple[api.SensedGround, api.SensedAngles]:
        x, z = state.position
        heights = np.array([self._profile.height(x + at) - z for at in self._x])
        ground = api.SensedGround(np.column_stack([self._x, heights]), heights)
        return ground, api.SensedAngles(state.front, state.rear, state.pitch)
