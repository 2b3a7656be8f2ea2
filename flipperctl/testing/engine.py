"""Checks of an engine: motion, signs, repeatability, limits, snapshots, and its rays, if any."""

from __future__ import annotations

import numpy as np

from flipperctl.api import (
    Engine,
    FloatArray,
    Limits,
    Profile,
    RayWorld,
    Robot,
    RobotState,
    Start,
    World,
)
from flipperctl.config import EnvConfig
from flipperctl.plugging.randomness import global_states, moved_since
from flipperctl.testing.check import of, require
from flipperctl.testing.conventions import probe_world, require_conventions

SAMPLES = 100
"""Number of samples in a run: one second, in which the robot drives about 0.2 m [-]."""
LEVEL = Profile([(0.0, 0.0)])
GROUND = Profile([(0.0, 0.0), (0.0, 0.1), (0.5, 0.1), (0.5, 0.0)])
_RAMP = Profile([(0.0, 0.0), (2.0, 1.0), (4.0, 1.0)])
_NUBOT = Robot()
START = Start(-0.8)
"""The flippers, which reach 0.716 m ahead, are clear of ``GROUND``."""
_TARGET = 0.3
"""Commanded angle of both flipper pairs [rad]."""
_LONG = 10 * SAMPLES
"""Number of samples within which a robot is on the ramp [-]."""
_AGAIN = 0.05
"""Difference of what follows a snapshot, which lacks forces in contacts [m or rad]."""
_BEYOND = 0.05
"""Angle by which a flipper may yield past its limit [rad]."""


@of("sim", "drives", everywhere=False)
def drives(engine: Engine) -> None:
    """Check that the robot drives at about track speed on level ground and turns its flippers."""
    # The robot of double speed goes first; the poses of the usual one are read below.
    for robot in (Robot(track_speed=2 * Robot().track_speed), Robot()):
        world = _place(engine, LEVEL, robot=robot)
        begun, poses = world.state(), _run(world)
        moved = float(poses[-1, 0] - begun.position[0])
        expected = robot.track_speed * SAMPLES / 100
        require(
            0.6 * expected < moved < 1.5 * expected,
            f"drives {moved:.3f} m in 1 s; {expected:g} m is expected of a robot with "
            f"track_speed={robot.track_speed:g}",
        )
    for name, turned in (("front", poses[-1, 3]), ("rear", poses[-1, 4])):
        require(
            turned > 0.1,
            f"the {name} flippers are at {turned:.2f} rad 1 s after a command of {_TARGET} rad",
        )


@of("sim", "end stops", everywhere=False)
def end_stops(engine: Engine) -> None:
    """Check that the flippers begin as the start says, and that no command turns them too far."""
    # In both directions, from within the limit to a command beyond it
    limit = Robot().angle_limit
    for sign in (1, -1):
        begun = sign * (limit - _TARGET)
        world = _place(engine, LEVEL, Start(START.x, front=begun, rear=begun))
        placed = world.state()
        require(
            abs(placed.front - begun) < _BEYOND and abs(placed.rear - begun) < _BEYOND,
            f"places flippers at {placed.front:.2f} and {placed.rear:.2f} rad that the start has "
            f"at {begun:.2f} rad",
        )
        world.command(sign * (limit + _TARGET), sign * (limit + _TARGET))
        angles = world.advance(2 * SAMPLES)[:, 3:]
        require(
            float(np.abs(angles).max()) < limit + _BEYOND,
            f"turns the flippers to {sign * np.abs(angles).max():.2f} rad when they are commanded "
            f"to {sign * (limit + _TARGET):.2f} rad; their limit is ±{limit:.2f} rad",
        )


@of("sim", "samples")
def samples(engine: Engine) -> None:
    """Check that ``advance`` returns finite poses, (S, 5), and that the last equals the state."""
    world = _place(engine, GROUND)
    poses = _run(world)
    require(poses.shape == (SAMPLES, 5), f"advance({SAMPLES}) has shape {poses.shape}")
    require(bool(np.isfinite(poses).all()), "a pose is not finite")
    last, state = poses[-1], _numbers(world.state())
    require(bool(np.allclose(last, state[:5])), f"the last pose is {last}, the state {state[:5]}")


@of("sim", "repeats")
def repeats(engine: Engine) -> None:
    """Check that equal worlds advance bit for bit equally, without other randomness."""
    before = global_states()
    first, other = (_run(_place(engine, GROUND)) for _ in range(2))
    require(bool(np.array_equal(first, other)), "two equal worlds end up in unequal poses")
    moved = moved_since(before)
    require(not moved, f"draws from {moved}; only rng is allowed")


@of("sim", "stops", everywhere=False)
def stops(engine: Engine) -> None:
    """Check that a run ends after the sample at which a limit is reached."""
    for ground, limits in ((LEVEL, Limits(x=START.x + 0.05)), (_RAMP, Limits(angle=0.1))):
        poses = _place(engine, ground).advance(_LONG, limits)
        reached = [limits.reached(*pose[:3]) for pose in poses.tolist()]
        require(
            len(reached) > 0 and reached[-1] and not any(reached[:-1]),
            f"runs for {len(poses)} samples, and not until the first one that reaches {limits}",
        )


@of("sim", "returns")
def returns(engine: Engine) -> None:
    """Check that loading a snapshot restores the state, the targets and what follows."""
    world = _place(engine, GROUND)
    world.command(2 * _TARGET, 2 * _TARGET)
    world.advance(SAMPLES // 2)  # the flippers are turning
    # What follows the snapshot is seen once, before the world is led astray.
    saved, state = world.save(), _numbers(world.state())
    later = world.advance(SAMPLES // 2)[-1]

    # Another motion, which loading must undo altogether
    world.command(-_TARGET, -_TARGET)
    world.advance(SAMPLES // 2)
    world.load(saved)
    loaded = _numbers(world.state())
    require(bool(np.allclose(loaded, state)), f"load leads to {loaded}; saved was {state}")
    again = world.advance(SAMPLES // 2)[-1]
    require(
        bool(np.allclose(again, later, atol=_AGAIN)),
        f"after load, the robot goes on to {again}; it had gone on to {later}",
    )


@of("sim", "rays", everywhere=False)
def rays(engine: Engine) -> None:
    """Check that rays, if the world casts them, end on the ground, or nowhere within reach."""
    world = _place(engine, GROUND)
    if not isinstance(world, RayWorld):
        return
    side = world.state().side
    directions = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.6, 0.0, -0.8]])
    distances = world.cast_rays(np.array([-1.5, side, 0.06]), directions, 2.0)
    # Down, to the face at x = 0, over level ground, sloping down
    expected = [0.06, 1.5, np.inf, 0.075]
    require(
        bool(np.allclose(distances, expected, atol=0.005)),
        f"casts rays to {distances} m; {expected} m are expected",
    )


@of("sim", "conventions", everywhere=False)
def conventions(engine: Engine) -> None:
    """Check signs, frames, units and timing of an engine's motion.

    The pressed flippers of an engine without forces, such as ``examples/kinematic.py``, do not
    pitch the chassis at all; one with a wrong sign pitches it the other way.
    """
    probes = list(probe_world(EnvConfig(terrain="flat", sim=engine)))
    lifting = [probe for probe in probes if "pressed down" in probe.meaning]
    without_forces = all(probe.found == 0 for probe in lifting)
    require_conventions([probe for probe in probes if not (without_forces and probe in lifting)])


def _place(engine: Engine, ground: Profile, start: Start = START, robot: Robot = _NUBOT) -> World:
    """Return a world of a robot with a new generator, seeded equally each time."""
    return engine.place(ground, robot, start, np.random.default_rng(0))


def _run(world: World) -> FloatArray:
    world.command(_TARGET, _TARGET)
    return world.advance(SAMPLES)


def _numbers(state: RobotState) -> FloatArray:
    x, z = state.position
    return np.array([x, z, state.pitch, state.front, state.rear, state.time])
