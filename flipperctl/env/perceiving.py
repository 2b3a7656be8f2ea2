"""What the policy of one episode perceives: the sensor's ground and angles as an observation.

In: true states. Out: perceptions, which remember the observations before them.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from flipperctl.api import MAX_HISTORY, Perception, Profile, RobotGeometry, RobotState, Sensor
from flipperctl.guard import fault


class Perceiver:
    """Senses the ground and the posture of one episode."""

    def __init__(
        self,
        sensor: Sensor,
        profile: Profile,
        margin: float,
        robot: RobotGeometry,
        rngs: tuple[np.random.Generator, np.random.Generator],
        friction: float | None = None,
    ) -> None:
        """Use ``sensor`` on ``profile`` with ``margin`` [m] of level ground on both sides.

        ``robot``: the robot that policies believe in; ``rngs``: the generators of the sensor's
        noise and of random policies; ``friction``: what policies are told of it [-].

        Raises:
            PluginFailedError: the sensor's code failed.
        """
        self._sensor, self._robot, self._friction = sensor, robot, friction
        self._sensor_rng, self._controller_rng = rngs
        self._layout = sensor.layout
        self._recent: deque[np.ndarray[tuple[int], np.dtype[np.float32]]]
        self._recent = deque(maxlen=MAX_HISTORY)
        try:
            self._in_use = sensor.over(profile, margin)
        except BaseException as error:
            raise fault(error, sensor, "over") from error

    def perceive(self, state: RobotState) -> Perception:
        """Sense once; equal generators and states give equal perceptions.

        Raises:
            PluginFailedError: the sensor's code failed.
        """
        layout = self._layout
        observation = np.empty(layout.size, dtype=np.float32)
        try:
            ground, angles = self._in_use.sense(state, self._sensor_rng)
            observation[: layout.bins] = ground.heights
            observation[layout.bins :] = angles.front, angles.rear, angles.pitch
        except BaseException as error:
            raise fault(error, self._sensor, "sense") from error
        self._recent.append(observation)
        return Perception(
            observation,
            ground.points,
            angles.pitch,
            angles.front,
            angles.rear,
            self._robot,
            layout,
            self._controller_rng,
            tuple(self._recent),
            ground.filled,
            self._friction,
        )


def fresh(rng: np.random.Generator) -> np.random.Generator:
    """Return a generator that draws what this one has drawn since it was made."""
    bits = rng.bit_generator
    seed = bits.seed_seq
    assert isinstance(seed, np.random.SeedSequence)  # as of every generator that was spawned
    return np.random.Generator(type(bits)(seed))
