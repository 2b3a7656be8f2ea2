"""An engine of your own: a robot that follows the ground without any dynamics.

Try it: ``flipperctl eval okada sim=kinematic --plugins examples/kinematic.py``
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

    def place(
        self,
        profile: api.Profile,
        robot: api.Robot,
        start: api.Start,
        rng: np.random.Generator,
    ) -> api.World:
        return Sliding(profile, robot, start, self.slowdown)


class Sliding:
    """One robot on one piece of ground; see ``flipperctl.api.World``."""

    def __init__(
        self, profile: api.Profile, robot: api.Robot, start: api.Start, slowdown: float
    ) -> None:
        self._profile, self._robot, self._slowdown = profile, robot, slowdown
        self._angles = self._targets = np.array([start.front, start.rear])
        self._x, self._time = start.x, 0.0

    @property
    def position(self) -> tuple[float, float]:
        rear, front = self._ends()
        return self._x, (rear + front) / 2 + self._robot.track_radius

    @property
    def pitch(self) -> float:
        rear, front = self._ends()
        return math.atan2(front - rear, 2 * self._robot.hinge_offset)

    def command(self, front: float, rear: float) -> None:
        limit = self._robot.angle_limit
        self._targets = np.clip([front, rear], -limit, limit)

    def advance(self, samples: int, limits: api.Limits = api.NO_LIMITS) -> api.FloatArray:
        turn = self._robot.flipper_speed * api.SAMPLE_PERIOD
        poses = []
        for _ in range(samples):
            self._x += self._velocity()[0] * api.SAMPLE_PERIOD
            self._angles = self._angles + np.clip(self._targets - self._angles, -turn, turn)
            self._time += api.SAMPLE_PERIOD
            poses.append([*self.position, self.pitch, *self._angles])
            if limits.reached(*self.position, self.pitch):
                break
        return np.array(poses)

    def state(self) -> api.RobotState:
        front, rear = map(float, self._angles)
        return api.RobotState(
            position=np.array(self.position),
            pitch=self.pitch,
            front=front,
            rear=rear,
            velocity=self._velocity(),
            pitch_rate=0.0,
            time=self._time,
        )

    def penetration(self) -> float:
        return 0.0

    def save(self) -> tuple[float, float, api.FloatArray, api.FloatArray]:
        return self._x, self._time, self._angles, self._targets

    def load(self, saved: tuple[float, float, api.FloatArray, api.FloatArray]) -> None:
        self._x, self._time, self._angles, self._targets = saved

    def _ends(self) -> tuple[float, float]:
        """Return the height of the ground below the rear and the front hinge [m]."""
        half = self._robot.hinge_offset
        return self._profile.height(self._x - half), self._profile.height(self._x + half)

    def _velocity(self) -> api.FloatArray:
        """Return the velocity along the chassis, (2,) [m/s]."""
        pitch = self.pitch
        speed = self._robot.track_speed * (1 - self._slowdown * abs(math.sin(pitch)))
        return speed * np.array([math.cos(pitch), math.sin(pitch)])
