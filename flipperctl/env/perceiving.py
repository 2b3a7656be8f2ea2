"""What the policy of one episode perceives: the sensor's ground and angles as an observation.

In: true states. Out: perceptions, which remember the observations before them.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from flipperctl.api import MAX_HISTORY, Perception, Profile, RobotGeometry, RobotState, Sensor
from flipperctl.core.observation import assemble
from flipperctl.env.sensing import GuardedSensor


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
        self._robot, self._friction = robot, friction
        self._sensor_rng, self._controller_rng = rngs
        self._layout = sensor.layout
        self._recent: deque[np.ndarray[tuple[int], np.dtype[np.float32]]]
        self._recent = deque(maxlen=MAX_HISTORY)
        self._in_use = GuardedSensor(sensor, profile, margin)

    def perceive(self, state: RobotState) -> Perception:
        """Sense once; equal generators and states give equal perceptions.

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: what it returned is not finite.
        """
        ground, angles = self._in_use.sense(state, self._sensor_rng)
        observation = assemble(
            ground.heights, front=angles.front, rear=angles.rear, pitch=angles.pitch
        )
        self._recent.append(observation)
        return Perception(
            observation,
            ground.points,
            angles.pitch,
            angles.front,
            angles.rear,
            self._robot,
            self._layout,
            self._controller_rng,
            tuple(self._recent),
            ground.filled,
            self._friction,
        )


def fresh(rng: np.random.Generator) -> np.random.Generator:
    """Return a generator that draws and spawns what this one has since it was made."""
    bits = rng.bit_generator
    seed = bits.seed_seq
    assert isinstance(seed, np.random.SeedSequence)  # as of every generator that was spawned
    # A copy, since a sequence counts what was spawned from it
    again = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
    return np.random.Generator(type(bits)(again))
