"""The perception of one episode, and the simulator of its scene for policies that look ahead.

In: true states, at samples and at decisions. Out: perceptions, which include earlier observations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from flipperctl.api import (
    MAX_HISTORY,
    SAMPLE_PERIOD,
    FloatArray,
    Instrument,
    Measured,
    Mounting,
    Outcome,
    Perception,
    Profile,
    RobotGeometry,
    RobotState,
    Sensor,
    World,
)
from flipperctl.core.building import built
from flipperctl.core.observation import assemble, bin_heights
from flipperctl.core.targets import Action, angles_of, of_pairs
from flipperctl.env.drive import Drive
from flipperctl.env.placed import mounted_parts, require_sensed_finite


class Perceiver:
    """Senses the ground and the posture of one episode."""

    def __init__(
        self,
        sensor: Sensor,
        mounting: Mounting,
        robot: RobotGeometry,
        rngs: tuple[np.random.Generator, np.random.Generator],
        friction: float | None = None,
        *,
        checked: bool = True,
    ) -> None:
        """Set up ``sensor`` for one episode, in which what it returns may be ``checked``.

        ``robot``: the robot that policies are given; ``rngs``: the generators of the sensor's
        noise and of random policies; ``friction``: the friction that policies are given [-].
        """
        self._robot, self._friction = robot, friction
        noise, self._controller_rng = rngs
        self._sensor, self._layout = sensor, sensor.layout
        self._recent: tuple[np.ndarray[tuple[int], np.dtype[np.float32]], ...] = ()
        parts = mounted_parts(sensor, mounting, robot, checked=checked)
        instruments, self._estimator, self._senses = parts
        # The first instrument draws from the sensor's generator, further ones from its children.
        generators = [noise, *noise.spawn(len(instruments) - 1)] if instruments else []
        self._parts = [
            (name, instrument, rng, _samples_between(instrument))
            for (name, instrument), rng in zip(instruments.items(), generators, strict=True)
        ]
        self._periods = sorted({every for *_, every in self._parts if every is not None})
        self._pending: list[Measured] = []
        """Measurements that the estimator has not received yet, because of the delay."""
        self._reports: tuple[Callable[[Measured], None], ...] = ()

    def attach(self, drive: Drive, *reports: Callable[[Measured], None]) -> None:
        """Measure at the samples of ``drive`` from now on; pass each measurement to ``reports``.

        If no instrument measures between decisions, ``drive`` is not changed.
        """
        self._reports = reports
        for interval in self._periods:
            drive.sample_every(interval, self._sampler(interval))

    def _sampler(self, interval: int) -> Callable[[World], None]:
        return lambda world: self._measure(interval, world.state())

    def measure(self, state: RobotState) -> None:
        """Measure with every instrument that has a period, whether or not it is due."""
        for interval in self._periods:
            self._measure(interval, state)

    def _measure(self, interval: int | None, state: RobotState) -> None:
        for name, instrument, rng, every in self._parts:
            if every == interval:
                value = instrument.measure(state, rng)
                if value is None:
                    continue
                self._pending.append(Measured(name, state.time, value))
                for report in self._reports:
                    report(self._pending[-1])

    def perceive(self, state: RobotState) -> Perception:
        """Perceive the robot in this state; equal generators and states give equal perceptions.

        The estimator receives the measurements up to the state's time. The arrays are the caller's,
        except for earlier observations, which are read-only.

        Raises:
            PluginFailedError: the sensor returned a value that is not allowed.
            NonFiniteError: a returned number is not finite.
        """
        self._measure(None, state)
        # Half a sample of tolerance, since times are sums of floats.
        newest = state.time + SAMPLE_PERIOD / 2
        pending, self._pending = self._pending, []
        # Measurements newer than the perceived state wait (``perception.delay``).
        for measured in pending:
            if measured.time <= newest:
                self._estimator.update(measured)
            else:
                self._pending.append(measured)
        ground, angles = self._estimator.estimate(state.time)
        require_sensed_finite(self._sensor, self._senses, ground, angles)
        heights, layout = ground.heights, self._layout
        # A sensor may know the heights of the bins; otherwise they follow from its points.
        if heights is None:
            points, highest = ground.points, layout.highest
            heights = bin_heights(points, layout.bins, layout.bin_width, highest=highest)
            heights = np.resize(heights, layout.heights)
        roll = angles.roll if layout.sides else None
        observation = assemble(heights, angles_of(angles), pitch=angles.pitch, roll=roll)
        # Later perceptions share a read-only copy; the newest array is the caller's.
        earlier, shared = self._recent[1 - MAX_HISTORY :], observation.copy()
        shared.setflags(write=False)
        self._recent = (*earlier, shared)
        return built(
            Perception,
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
            roll=angles.roll,
            flippers=angles.flippers,
        )

    def map_points(self) -> FloatArray | None:
        """Return the points of the sensor's map, (P, 3) in frame L [m]; None if it keeps none."""
        points = getattr(self._estimator, "map_points", None)
        return None if points is None else np.asarray(points())

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot of memories, generators and recent observations for ``load``."""
        parts = [(part.save(), rng.bit_generator.state) for _, part, rng, _ in self._parts]
        random = self._controller_rng.bit_generator.state
        return parts, random, self._estimator.save(), tuple(self._pending), self._recent

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        parts, random, estimator, pending, self._recent = saved
        for (_, part, rng, _), (memory, state) in zip(self._parts, parts, strict=True):
            part.load(memory)
            rng.bit_generator.state = state
        self._controller_rng.bit_generator.state = random
        self._estimator.load(estimator)
        self._pending = list(pending)


def _samples_between(instrument: Instrument) -> int | None:
    """Return the samples between two measurements; None: one for each decision [-]."""
    period = instrument.period
    return None if period is None else round(period / SAMPLE_PERIOD)


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


class SceneSimulator:
    """Implements ``flipperctl.api.Simulator``; the world is built on first use."""

    def __init__(
        self,
        make: Callable[[], Drive],
        perceiver: Callable[[Drive, bool], Perceiver],
        profile: Profile,
        report_progress: Callable[[float], None],
    ) -> None:
        """Simulate the ``Drive`` that ``make`` builds; pass progress to ``report_progress``.

        ``perceiver`` returns a new perceiver that measures at the samples of a ``Drive``: with the
        noise of the episode, or, if its second argument is true, without errors.
        """
        self._make, self._make_perceiver = make, perceiver
        self.profile = profile
        """True ground of the episode."""
        self.seed: int | None = None
        """Seed of the episode."""
        self._report_progress = report_progress
        self.results: dict[str, float | str] = {}
        """What the policy reported about its search."""
        self.restart()

    def restart(self) -> None:
        """Return to the start in a new world, which reproduces the episode bit for bit."""
        self._made: Drive | None = None
        self._perceivers: dict[bool, Perceiver] = {}

    @property
    def _drive(self) -> Drive:
        if self._made is None:
            self._made = self._make()
        return self._made

    @property
    def state(self) -> RobotState:
        """Current state of the robot."""
        return self._drive.state

    @property
    def robot(self) -> RobotGeometry:
        """Geometry of the robot."""
        return self._drive.robot

    @property
    def speed(self) -> float:
        """Speed of the belts [m/s]."""
        return self._drive.robot.track_speed

    @property
    def finish(self) -> float:
        """World x that the chassis centre must pass [m]."""
        return self._drive.termination.finish

    @property
    def poses(self) -> FloatArray:
        """Poses of the last decision at 100 Hz, the pose before it first, (S + 1, 3 + J)."""
        return self._drive.poses

    def perceive(self) -> Perception:
        """Return the policy's current perception; see ``flipperctl.api.Simulator``."""
        return self._perceiver(exact=False).perceive(self._drive.delayed_state)

    def perceive_exactly(self) -> Perception:
        """Return the perception of a sensor without errors; see ``flipperctl.api.Simulator``."""
        return self._perceiver(exact=True).perceive(self._drive.state)

    def _perceiver(self, *, exact: bool) -> Perceiver:
        if exact not in self._perceivers:
            self._perceivers[exact] = self._make_perceiver(self._drive, exact)
        return self._perceivers[exact]

    def step(self, action: Action) -> Outcome | None:
        """Simulate one decision; return the outcome, or None while the episode runs."""
        return self._drive.decide(of_pairs(action, len(self._drive.robot.joints)))

    def save(self) -> Any:
        """Return a snapshot of the scene for ``load``."""
        perceivers = {
            exact: (perceiver, perceiver.save()) for exact, perceiver in self._perceivers.items()
        }
        return self._drive.save(), perceivers

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        drive, perceivers = saved
        self._drive.load(drive)
        self._perceivers = {exact: perceiver for exact, (perceiver, _) in perceivers.items()}
        for perceiver, memory in perceivers.values():
            perceiver.load(memory)

    def report_progress(self, fraction: float) -> None:
        """Report the completed fraction of a long search, in [0, 1]."""
        self._report_progress(fraction)

    def report_result(self, **values: float | str) -> None:
        """Report numbers and texts about the search, to be added to the episode's result."""
        self.results.update(values)
