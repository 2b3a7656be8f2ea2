"""The prediction model on one piece of ground: many decisions from many states.

In: a polyline of the ground, a robot, and states. Out: the states after a decision, and the pitch
variation of the chassis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Robot
from flipperctl.lookahead import dynamics, layout
from flipperctl.lookahead.contacts import MOST
from flipperctl.lookahead.layout import STATE
from flipperctl.sim.sampling import samples_in, simulated
from flipperctl.sim.thinning import kept_points

FLIPPERS, TARGETS = 6, 8
"""Index in a state of the flippers' angles, and of their targets."""
_STRAIGHT = 1e-6
"""Distance from a straight edge within which points are left out [m]."""
_LEVEL_GROUND = 20.0  # length of the level ground on both sides of the known ground [m]


@dataclass(frozen=True)
class Branch:
    """Results of one decision from each of M states."""

    states: FloatArray
    """States after the decision, (M, ``STATE``)."""
    places: FloatArray
    """x and z of the chassis centre after the decision, (M, 2) [m]."""
    pitch_variation: FloatArray
    """Sum of the absolute pitch changes from step to step, (M,) [rad]."""
    steepest: FloatArray
    """Largest absolute pitch of any step, (M,) [rad]."""
    outcome: NDArray[np.int64]
    """How each decision ended, (M,): ``RUNNING``, ``OVERTURNED``, or ``REACHED`` where poses were
    asked for."""
    poses: FloatArray
    """Poses from before the decision to its end at 100 Hz, (M, S + 1, 5), if they were asked for,
    else (M, 0, 5): x [m], z [m], pitch, front and rear flipper angle [rad]."""

    def take(self, rows: NDArray[np.int64]) -> Branch:
        """Return some of the decisions."""
        return Branch(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


class Model:
    """A robot on a polyline."""

    def __init__(
        self,
        line: FloatArray,
        robot: Robot,
        friction: float = 1.0,
        step: float = 0.02,
        iterations: int = 10,
        overturn: float = math.pi / 3,
        gravity: float = 9.81,
        finish: float = math.inf,
        top: float = math.inf,
        contacts: int = MOST,
    ) -> None:
        """Extend ``line``, (V, 2) [m] with x never decreasing, by level ground on both sides.

        A robot has reached the ``finish``, x of the chassis centre [m], when both ends of its
        chassis are below ``top`` [m]. An unknown finish is infinitely far away. ``contacts``: the
        largest number of them.
        """
        self.overturn = overturn
        self._ground = _edges(line)
        axle = robot.flipper_axle
        k = np.zeros(layout.NUMBERS)
        k[layout.HINGE], k[layout.AXLE] = robot.hinge_offset, axle
        k[layout.RADIUS] = robot.track_radius
        k[layout.CHASSIS], k[layout.FLIPPER] = robot.carried_mass, robot.flipper_mass
        k[layout.TURN_CHASSIS] = _inertia(
            robot.chassis_mass, 2 * robot.hinge_offset, robot.track_radius
        ) + sum(robot.load_inertia)
        k[layout.LOAD_X], k[layout.LOAD_Z] = robot.centre_of_mass
        k[layout.FORCE] = math.inf if robot.track_force is None else robot.track_force
        k[layout.TURN_FLIPPER] = _inertia(robot.flipper_mass, axle, robot.track_radius)
        k[layout.SPEED], k[layout.RATE] = robot.track_speed, robot.flipper_speed
        k[layout.GRAVITY], k[layout.FRICTION] = gravity, friction
        k[layout.STEP], k[layout.ITERATIONS] = step, iterations
        k[layout.OVERTURN], k[layout.SAMPLE] = overturn, SAMPLE_PERIOD
        k[layout.FINISH], k[layout.TOP], k[layout.CONTACTS] = finish, top, contacts
        self._numbers = k
        self._step = step

    def state(
        self,
        pose: tuple[float, float, float],
        flippers: tuple[float, float],
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> FloatArray:
        """Return the state of a robot whose flippers are at their targets, (``STATE``,).

        ``pose``: x, z [m] of the chassis centre and pitch; ``rates``: their rates of change.
        ``flippers``: angles of the front and the rear flippers in frame R [rad].
        """
        x, z, pitch = pose
        gx, gz, _ = dynamics.mass_centre(*flippers, self._numbers)
        dx = math.cos(pitch) * gx - math.sin(pitch) * gz
        dz = math.sin(pitch) * gx + math.cos(pitch) * gz
        vx, vz, turn = rates
        motion = (vx - turn * dz, vz + turn * dx, turn)
        return np.array([x + dx, z + dz, pitch, *motion, *flippers, *flippers])

    def chassis(self, state: FloatArray) -> tuple[float, float]:
        """Return x and z of the chassis centre [m]."""
        x, z = dynamics.chassis(state, self._numbers)
        return float(x), float(z)

    def expand(
        self, states: FloatArray, targets: FloatArray, duration: float, *, poses: bool = False
    ) -> Branch:
        """Simulate ``duration`` [s] from each state, (M, ``STATE``); ``targets`` are (M, 2).

        With ``poses``, the branch has the poses at 100 Hz, and ends at the finish.
        """
        count = len(states)
        found, place = np.empty((count, STATE)), np.empty((count, 2))
        variation, steepest = np.empty(count), np.empty(count)
        outcome = np.empty(count, np.int64)
        lasting = simulated(duration)
        steps = math.ceil(lasting / self._step - 1e-9)
        numbers = self._numbers
        if abs(steps * self._step - lasting) > 1e-9:
            numbers = numbers.copy()
            numbers[layout.STEP] = lasting / steps
        samples = samples_in(duration) + 1 if poses else 0
        path = np.empty((count, samples, 5))
        dynamics.expand(
            *(np.ascontiguousarray(states), np.ascontiguousarray(targets), steps),
            *(self._ground, numbers, found, place, variation, steepest, outcome, path),
        )
        return Branch(found, place, variation, steepest, outcome, path)


@cache
def compile_now() -> None:
    """Compile the dynamics, or read them from the cache on disk."""
    model = Model(np.zeros((1, 2)), Robot())
    state = model.state((0.0, 0.2, 0.0), (0.0, 0.0))
    model.expand(state[None], np.zeros((1, 2)), 0.02)


def _inertia(mass: float, axle: float, radius: float) -> float:
    """Return the moment of inertia of a capsule's bounding box, as the engine takes it [kg m²]."""
    length, width = axle + 2 * radius, 2 * radius
    return mass * (length * length + width * width) / 12


def _edges(line: FloatArray) -> FloatArray:
    """Return points with the normals and lengths of the edges that begin there, (V, 5)."""
    points = np.vstack([line[0] - (_LEVEL_GROUND, 0.0), line, line[-1] + (_LEVEL_GROUND, 0.0)])
    distinct = np.concatenate([[True], (np.diff(points, axis=0) != 0).any(axis=1)])
    points = points[distinct]
    # Points inside of straight edges would be contacts of their own, which push the robot ahead.
    points = points[kept_points(points, np.zeros(len(points), np.bool_), _STRAIGHT, 0.0)]
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    normals = np.column_stack([-step[:, 1], step[:, 0]]) / length[:, None]
    edges = np.column_stack([normals, length])
    return np.column_stack([points, np.vstack([edges, [0.0, 1.0, 0.0]])])
