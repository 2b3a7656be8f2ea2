"""Probe the signs, frames, units and timing of engines, sensing and exported policies.

In: a configuration, and an exported file. Out: the measured value of each probe, the one that the
contract (``flipperctl.api``) states, and their table. A flipped sign or frame is the usual cause of
a policy that fails without an error in another engine, so no probe passes with the opposite sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.api import (
    FloatArray,
    Mounting,
    Profile,
    Robot,
    RobotState,
    Start,
    World,
)
from flipperctl.config import EnvConfig
from flipperctl.core.observation import angles
from flipperctl.core.targets import alike, angles_of, by_joint, means, turns
from flipperctl.env.perceiving import Perceiver
from flipperctl.env.placed import place as place_checked
from flipperctl.errors import ConformanceError
from flipperctl.evaluation.engines import in_default_engine
from flipperctl.policies.source import ExportedPolicy, PolicySource
from flipperctl.runtime.interface import Interface
from flipperctl.text.show import Column, Table

_FLAT = Profile([(0.0, 0.0)])
_SLOPE = math.radians(15)
_STEP, _EDGE = 0.3, 0.6
"""Height of the sensed step, and its distance ahead of the chassis centre [m]."""


@dataclass(frozen=True)
class Probe:
    """One measurement and the value that the contract states."""

    of: str
    """Probed object: an engine, a sensor or a file."""
    meaning: str
    unit: str
    found: float
    expected: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the measurement is within the tolerance."""
        return bool(abs(self.found - self.expected) <= self.tolerance)  # found may be numpy's


def probe(config: EnvConfig, source: PolicySource) -> list[Probe]:
    """Return the probes of both engines, of sensing and, if it is exported, of a policy's file."""
    probes = [*probe_world(in_default_engine(config)), *probe_world(config), *probe_sensing(config)]
    if source.is_exported:
        interface = ExportedPolicy(source.file).interface
        probes += probe_export(interface, config.robot, str(source.file))
    return probes


def require_conventions(probes: Sequence[Probe]) -> None:
    """Raise ``ConformanceError`` for the first of the probes that differs from the contract."""
    if wrong := [probe for probe in probes if not probe.holds]:
        first = wrong[0]
        raise ConformanceError(
            f"{len(wrong)} of {len(probes)} conventions do not hold, first {first.of}: "
            f"{first.meaning} is {first.found:.3f} {first.unit}; {first.expected:.3f} ± "
            f"{first.tolerance:.3f} is allowed"
        )


_COLUMNS = (
    Column("of", "probed", named=True),
    Column("meaning", "convention", wrapped=True),
    Column("found", "found"),
    Column("expected", "expected"),
    Column("holds", ""),
)


def table(probes: Sequence[Probe]) -> Table:
    """Return a row for each convention."""
    rows = [
        {
            "of": probe.of,
            "meaning": probe.meaning,
            "found": f"{probe.found:.3f}{unit}",
            "expected": f"{probe.expected:.3f} ± {probe.tolerance:.3f}{unit}",
            "holds": "holds" if probe.holds else "WRONG",
        }
        for probe in probes
        for unit in ("" if probe.unit == "-" else f" {probe.unit}",)
    ]
    return Table(_COLUMNS, rows)


def probe_world(config: EnvConfig) -> Iterator[Probe]:
    """Yield the probes of the configured engine with the configured robot.

    The robot drives on level ground, turns each flipper pair, and drives up a ramp.
    """
    robot, name = config.robot, f"sim={config.sim.plugin_name}"

    def probe(meaning: str, unit: str, measured: float, expected: float, tolerance: float) -> Probe:
        return Probe(name, meaning, unit, measured, expected, tolerance)

    def place(profile: Profile, x: float) -> World:
        return place_checked(config.sim, profile, robot, Start(x), np.random.default_rng(0))

    # Forwards on level ground: x, z, velocity and time
    world = place(_FLAT, 0.0)
    world.advance(200)
    state = world.state()
    distance = 2 * robot.track_speed  # in 2 s [m]
    yield probe("x after driving forward for 2 s", "m", state.position[0], distance, 0.1 * distance)
    yield probe(
        "z of the chassis on level ground, up", "m", state.position[1], robot.track_radius, 0.01
    )
    yield probe("velocity along x", "m/s", state.velocity[0], distance / 2, 0.1 * distance)
    yield probe("time of 200 samples", "s", state.time, 2.0, 1e-6)

    # Each pair turned up, while the other one stays
    step = min(robot.angle_step, robot.angle_limit)
    samples = round(100 * (robot.angle_step / robot.flipper_speed))
    for pair, index in (("front", 0), ("rear", 1)):
        world = place(_FLAT, 0.0)
        targets = [step if i == index else 0.0 for i in range(2)]
        world.command(*alike(targets, len(robot.joints)))
        angles = means(world.advance(samples)[-1, 3:].tolist())
        yield probe(
            f"{pair} flippers turned up by one action", "rad", angles[index], step, 0.15 * step
        )
        yield probe(
            f"other flippers while the {pair} ones turn", "rad", angles[1 - index], 0.0, 0.15 * step
        )
        yield from _lifting(probe, place(_FLAT, 0.0), pair, index, robot)

    # Up a ramp, until the whole chassis is on it
    run = 3.0
    ramp = Profile([(0.0, 0.0), (run, run * math.tan(_SLOPE))])
    world = place(ramp, -0.9)
    world.advance(math.ceil(100 * 1.9 / robot.track_speed))
    yield probe("pitch on a ramp up of 15°, nose up", "rad", world.pitch, _SLOPE, 0.05)
    x, z = world.position
    above = z - ramp.height(x) - robot.track_radius / math.cos(_SLOPE)
    yield probe("z above the ramp, less the track's radius", "m", above, 0.0, 0.02)


def _lifting(probe: Any, world: World, pair: str, index: int, robot: Robot) -> Iterator[Probe]:
    """Yield probes of the pitch while one pair presses on the ground and still turns."""
    # The flippers must still turn at the end, so that the pitch rate is of a moving robot.
    samples = math.ceil(100 * min(0.5, 0.8 * robot.angle_limit / robot.flipper_speed))
    turned = samples / 100 * robot.flipper_speed
    targets = [-robot.angle_limit if i == index else 0.0 for i in range(2)]
    world.command(*alike(targets, len(robot.joints)))
    before = world.advance(samples)[-1, 2]
    rate = world.state().pitch_rate
    pitch = world.advance(2)[-1, 2]
    # The robot turns about the level tip at its other end; the pressing tip is ``ahead`` of it.
    reach = robot.flipper_axle
    ahead = 2 * robot.hinge_offset + reach + reach * math.cos(turned)
    sign = 1.0 if index == 0 else -1.0
    expected = sign * math.atan2(reach * math.sin(turned), ahead)
    tolerance, change = 0.3 * abs(expected), (pitch - before) / 0.02
    yield probe(f"pitch, {pair} flippers pressed down", "rad", before, expected, tolerance)
    yield probe(
        f"pitch rate, {pair} flippers pressed down", "rad/s", rate, change, 0.5 * abs(change) + 0.02
    )


def probe_sensing(config: EnvConfig) -> Iterator[Probe]:
    """Yield the probes of the observation in front of a step, without noise, bias and delay."""
    # The step ahead and the level ground behind are exact without noise, bias and delay.
    plain = config.perception.exact()
    layout, radius = plain.layout, config.robot.track_radius
    rngs = np.random.default_rng(0), np.random.default_rng(0)
    ground = Profile([(_EDGE, 0.0), (_EDGE, _STEP)])
    state = RobotState(
        np.array([0.0, radius]),
        pitch=0.3,
        **by_joint(alike((0.2, -0.1), len(layout.joints))),
        velocity=np.zeros(2),
        pitch_rate=0.0,
        time=0.0,
    )
    world = place_checked(config.sim, ground, config.robot, Start(0.0), rngs[0])
    mounting = Mounting(config.robot, ground, layout.reach + 3.0, world, rngs[1])
    perceiver = Perceiver(plain, mounting, config.robot, rngs)
    perceiver.measure(state)

    # The observation in its documented order
    seen: FloatArray = perceiver.perceive(state).observation.astype(np.float64)
    name = f"perception={config.perception.plugin_name}"

    def probe(meaning: str, unit: str, index: int, expected: float) -> Probe:
        return Probe(name, meaning, unit, float(seen[index]), expected, 0.02)

    # In frame L, which stays level at any pitch
    yield probe("first height, behind the robot", "m", 0, -radius)
    yield probe("last height, on the step ahead", "m", layout.bins - 1, _STEP - radius)
    first = layout.size - 1 - len(layout.joints)
    for at, (joint, angle) in enumerate(zip(layout.joints, angles_of(state), strict=True), first):
        yield probe(f"{joint.replace('_', ' ')} flippers", "rad", at, angle)
    yield probe("pitch, nose up", "rad", layout.size - 1, 0.3)


def probe_export(interface: Interface, robot: Robot, file: str) -> Iterator[Probe]:
    """Yield the probes of an exported policy's actions, targets and timing against a robot's."""
    joints = robot.joints
    for index, row in enumerate(turns(robot.angle_step, interface.kind, len(joints)).tolist()):
        for at, (joint, expected) in enumerate(zip(joints, row, strict=True)):
            name = f"{joint} pair" if len(joints) == 2 else joint.replace("_", " ")
            turned = float(interface.actions[index, at])
            what = f"turn of the {name} by action {index}"
            yield Probe(file, what, "rad", turned, expected, 1e-6)

    # Targets and timing, which the controller on a robot computes from the file
    rule = interface.targets
    largest, window = "largest target, in both directions", "distance between target and angle"
    yield Probe(file, largest, "rad", rule.limit, robot.angle_limit, 1e-6)
    yield Probe(file, window, "rad", rule.window, robot.angle_step, 1e-6)
    period = interface.decision_period
    yield Probe(file, "time between two actions", "s", period, robot.decision_period, 1e-6)
    names = angles(joints=len(joints))
    right = tuple(q.name for q in interface.observation[-len(names) :]) == names
    yield Probe(file, "order of the angles: front, rear, pitch", "-", float(right), 1.0, 0.0)
