"""The perception of one episode: estimates from a sensor's measurements.

In: true states, at samples and at decisions. Out: perceptions, which include earlier observations.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import (
    MAX_HISTORY,
    SAMPLE_PERIOD,
    Measured,
    Mounting,
    Perception,
    RobotGeometry,
    RobotState,
    Sensor,
    World,
)
from flipperctl.core.observation import assemble
from flipperctl.env.drive import Drive
from flipperctl.env.guarded_sensor import MountedInstrument, mounted_parts


@dataclass(frozen=True)
class _Part:
    """An instrument with its name and its own generator."""

    name: str
    instrument: MountedInstrument
    rng: np.random.Generator


class Perceiver:
    """Senses the ground and the posture of one episode."""

    def __init__(
        self,
        sensor: Sensor,
        mounting: Mounting,
        robot: RobotGeometry,
        rngs: tuple[np.random.Generator, np.random.Generator],
        friction: float | None = None,
    ) -> None:
        """Set up ``sensor`` for one episode.

        ``robot``: the robot that policies are given; ``rngs``: the generators of the sensor's
        noise and of random policies; ``friction``: the friction that policies are given [-].

        Raises:
            PluginFailedError: the sensor's code failed.
        """
        self._robot, self._friction = robot, friction
        noise, self._controller_rng = rngs
        self._layout = sensor.layout
        self._recent: deque[np.ndarray[tuple[int], np.dtype[np.float32]]]
        self._recent = deque(maxlen=MAX_HISTORY)
        instruments, self._estimator = mounted_parts(sensor, mounting, robot)
        generators = [noise, *noise.spawn(len(instruments) - 1)] if instruments else []
        self._parts = [
            _Part(name, instrument, rng)
            for (name, instrument), rng in zip(instruments.items(), generators, strict=True)
        ]
        self._pending: list[Measured] = []
        """Measurements that the estimator has not received yet, because of the delay."""
        self._reports: tuple[Callable[[Measured], None], ...] = ()

    def attach(self, drive: Drive, *reports: Callable[[Measured], None]) -> None:
        """Measure at the samples of ``drive`` from now on; pass each measurement to ``reports``.

        If no instrument measures between decisions, ``drive`` is not changed.
        """
        self._reports = reports
        for every in sorted({p.instrument.every for p in self._parts if p.instrument.every}):
            drive.sample_every(every, self._sampler(every))

    def _sampler(self, every: int) -> Callable[[World], None]:
        return lambda world: self._measure(every, world.state())

    def measure(self, state: RobotState) -> None:
        """Measure with every instrument that has a period, whether or not it is due."""
        for every in sorted({p.instrument.every for p in self._parts if p.instrument.every}):
            self._measure(every, state)

    def _measure(self, every: int | None, state: RobotState) -> None:
        for part in self._parts:
            if part.instrument.every == every:
                value = part.instrument.measure(state, part.rng)
                if value is None:
                    continue
                self._pending.append(Measured(part.name, state.time, value))
                for report in self._reports:
                    report(self._pending[-1])

    def perceive(self, state: RobotState) -> Perception:
        """Perceive the robot in this state; equal generators and states give equal perceptions.

        The estimator receives the measurements up to the state's time. The arrays are the caller's,
        except for earlier observations, which are read-only.

        Raises:
            PluginFailedError: the sensor's code failed, or returned a value that is not allowed.
            NonFiniteError: a returned number is not finite.
        """
        self._measure(None, state)
        newest = state.time + SAMPLE_PERIOD / 2
        pending, self._pending = self._pending, []
        for measured in pending:
            if measured.time <= newest:
                self._estimator.update(measured)
            else:
                self._pending.append(measured)
        ground, angles = self._estimator.estimate(state.time)
        observation = assemble(
            ground.heights, front=angles.front, rear=angles.rear, pitch=angles.pitch
        )
        earlier = tuple(self._recent)[1 - MAX_HISTORY :]
        self._recent.append(observation.copy())
        self._recent[-1].setflags(write=False)  # later perceptions share it
        return Perception(
            observation=observation,
            points=ground.points.copy(),
            pitch=angles.pitch,
            front=angles.front,
            rear=angles.rear,
            robot=self._robot,
            layout=self._layout,
            rng=self._controller_rng,
            recent=(*earlier, observation),
            filled=_copy(ground.filled),
            friction=self._friction,
            seen=_copy(ground.seen),
            position=_copy(ground.position),
            deviation=_copy(ground.deviation),
        )

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of memories, generators and recent observations for ``load``."""
        parts = [(p.instrument.save(), p.rng.bit_generator.state) for p in self._parts]
        random = self._controller_rng.bit_generator.state
        return parts, random, self._estimator.save(), tuple(self._pending), tuple(self._recent)

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        parts, random, estimator, pending, recent = saved
        for part, (memory, state) in zip(self._parts, parts, strict=True):
            part.instrument.load(memory)
            part.rng.bit_generator.state = state
        self._controller_rng.bit_generator.state = random
        self._estimator.load(estimator)
        self._pending = list(pending)
        self._recent = deque(recent, maxlen=MAX_HISTORY)


def _copy(array: Any) -> Any:
    return None if array is None else array.copy()


def initial_copy(rng: np.random.Generator) -> np.random.Generator:
    """Return a copy of a generator in its initial state, with the same children to spawn."""
    bits = rng.bit_generator
    seed = bits.seed_seq
    assert isinstance(seed, np.random.SeedSequence)  # as of every generator that was spawned
    # A copy, since a sequence counts its children
    again = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
    return np.random.Generator(type(bits)(again))
