"""The prediction model on one piece of ground: many decisions from many states.

In: a polyline of the ground, a robot, and states. Out: the states after a decision, and the pitch
variation of the chassis. Also the perceptions there without sensing errors, and the transitions
that reward terms see.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    ACTIONS,
    LAST_PITCHES,
    SAMPLE_PERIOD,
    FloatArray,
    ObservationLayout,
    Outcome,
    Profile,
    Robot,
    RobotGeometry,
    RobotState,
    RobotStates,
    Transitions,
)
from flipperctl.core.targets import TargetRule
from flipperctl.lookahead import dynamics
from flipperctl.lookahead.dynamics import MOST, OVERTURNED, REACHED, STATE
from flipperctl.sim.ground import kept_points
from flipperctl.sim.versions import samples_in, simulated

FLIPPERS, TARGETS = 6, 8
"""Index in a state of the flippers' angles, and of their targets."""
_STRAIGHT = 1e-6  # distance from a straight edge within which points are left out [m]
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
        # Compiled code takes all numbers as one array; ``dynamics`` has the indices.
        k = np.zeros(dynamics.NUMBERS)
        k[dynamics.HINGE], k[dynamics.AXLE] = robot.hinge_offset, axle
        k[dynamics.RADIUS] = robot.track_radius
        k[dynamics.CHASSIS], k[dynamics.FLIPPER] = robot.carried_mass, robot.flipper_mass
        k[dynamics.TURN_CHASSIS] = _inertia(
            robot.chassis_mass, 2 * robot.hinge_offset, robot.track_radius
        ) + sum(robot.load_inertia)
        k[dynamics.LOAD_X], k[dynamics.LOAD_Z] = robot.centre_of_mass
        k[dynamics.FORCE] = math.inf if robot.track_force is None else robot.track_force
        k[dynamics.TURN_FLIPPER] = _inertia(robot.flipper_mass, axle, robot.track_radius)
        k[dynamics.SPEED], k[dynamics.RATE] = robot.track_speed, robot.flipper_speed
        k[dynamics.GRAVITY], k[dynamics.FRICTION] = gravity, friction
        k[dynamics.STEP], k[dynamics.ITERATIONS] = step, iterations
        k[dynamics.OVERTURN], k[dynamics.SAMPLE] = overturn, SAMPLE_PERIOD
        k[dynamics.FINISH], k[dynamics.TOP], k[dynamics.CONTACTS] = finish, top, contacts
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
        # States hold the centre of mass, from which the chassis centre differs by flippers and
        # load.
        gx, gz, _ = dynamics.mass_centre(*flippers, self._numbers)
        dx = math.cos(pitch) * gx - math.sin(pitch) * gz
        dz = math.sin(pitch) * gx + math.cos(pitch) * gz
        vx, vz, turn = rates
        motion = (vx - turn * dz, vz + turn * dx, turn)
        return np.array([x + dx, z + dz, pitch, *motion, *flippers, *flippers])

    def known(self, robot: RobotState, targets: tuple[float, float]) -> FloatArray:
        """Return the state of a robot that is known, (``STATE``,), with these flipper targets."""
        x, z = robot.position.tolist()
        rates = (*robot.velocity.tolist(), robot.pitch_rate)
        state = self.state((x, z, robot.pitch), (robot.front, robot.rear), rates)
        state[TARGETS:] = targets
        return state

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

        # Steps of equal length that end together with the decision
        lasting = simulated(duration)
        steps = math.ceil(lasting / self._step - 1e-9)
        numbers = self._numbers
        if abs(steps * self._step - lasting) > 1e-9:
            numbers = numbers.copy()
            numbers[dynamics.STEP] = lasting / steps
        # One pose more than samples, since the first is from before the decision
        samples = samples_in(duration) + 1 if poses else 0
        branch = Branch(
            states=np.empty((count, STATE)),
            places=np.empty((count, 2)),
            pitch_variation=np.empty(count),
            steepest=np.empty(count),
            outcome=np.empty(count, np.int64),
            poses=np.empty((count, samples, 5)),
        )
        dynamics.expand(
            np.ascontiguousarray(states),
            np.ascontiguousarray(targets),
            steps,
            self._ground,
            numbers,
            branch.states,
            branch.places,
            branch.pitch_variation,
            branch.steepest,
            branch.outcome,
            branch.poses,
        )
        return branch


def next_targets(
    robot: RobotGeometry, targets: tuple[float, float], angles: tuple[float, float], action: int
) -> tuple[float, float]:
    """Return the flippers' targets after an action, by the rule of the robot [rad]."""
    rule = TargetRule(window=robot.angle_step, limit=robot.angle_limit)
    turns = [turn * robot.angle_step for turn in ACTIONS[action]]
    front, rear = rule.next_targets(targets, angles, turns)
    return front, rear


def nominal(geometry: RobotGeometry) -> Robot:
    """Return a robot of this geometry, with its own masses and speeds if they are known."""
    if isinstance(geometry, Robot):
        return geometry
    return Robot(**geometry.model_dump())


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


TURNS = np.array(ACTIONS)
"""Turns (front, rear) of each action, (9, 2)."""
_OUTCOMES = np.array([None, None, None], dtype=object)
_OUTCOMES[OVERTURNED], _OUTCOMES[REACHED] = Outcome.OVERTURNED, Outcome.REACHED


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """M predicted robots, each before its next decision."""

    states: FloatArray  # states of the prediction model, (M, ``STATE``)
    places: FloatArray  # x and z of the chassis centre, (M, 2) [m]
    pitches: FloatArray
    """Pitch at the last decisions and now, (M, T) [rad]; at most ``LAST_PITCHES``."""
    turns: NDArray[np.int64]  # turns (front, rear) of the last decision, (M, 2); 0 before the first
    time: FloatArray  # time since the start of the episode, (M,) [s]

    def __len__(self) -> int:
        return len(self.states)

    def take(self, rows: NDArray[np.int64]) -> Nodes:
        """Return some of the nodes."""
        return Nodes(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    @classmethod
    def at_rest(cls, states: FloatArray, places: FloatArray) -> Nodes:
        """Return robots that have stood with their present pitch.

        An episode knows no pitch before its start; all nodes of a graph have equally many.
        """
        count = len(states)
        return cls(
            states=states,
            places=places,
            pitches=np.repeat(states[:, 2:3], LAST_PITCHES, axis=1),
            turns=np.zeros((count, 2), np.int64),
            time=np.zeros(count),
        )

    @classmethod
    def joined(cls, parts: Sequence[Nodes]) -> Nodes:
        """Return the nodes of several parts."""
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})

    def moved_to(self, others: Nodes, rows: NDArray[np.int64]) -> Nodes:
        """Return the nodes with the states of ``others`` in some ``rows``, with their own past."""
        states, places, pitches = self.states.copy(), self.places.copy(), self.pitches.copy()
        states[rows], places[rows] = others.states, others.places
        pitches[rows, -1] = others.states[:, 2]
        return replace(self, states=states, places=places, pitches=pitches)

    def after(self, branch: Branch, action: NDArray[np.int64], period: float) -> Nodes:
        """Return the nodes to which a decision of ``period`` [s] leads from each node.

        ``branch`` and ``action`` (M,) belong to these nodes, row by row.
        """
        pitches = np.column_stack([self.pitches, branch.states[:, 2]])[:, -LAST_PITCHES:]
        return Nodes(
            states=branch.states,
            places=branch.places,
            pitches=pitches,
            turns=TURNS[action],
            time=self.time + period,
        )

    def robots(self) -> RobotStates:
        """Return the nodes as the states that reward terms see."""
        states, places = self.states, self.places
        offset = states[:, :2] - places  # from the chassis centre to the centre of mass [m]
        turn = states[:, 5]
        velocity = np.column_stack(
            [states[:, 3] + turn * offset[:, 1], states[:, 4] - turn * offset[:, 0]]
        )
        return RobotStates(
            position=places,
            pitch=states[:, 2],
            front=states[:, FLIPPERS],
            rear=states[:, FLIPPERS + 1],
            velocity=velocity,
            pitch_rate=turn,
            time=self.time,
        )


def transitions(
    before: Nodes, after: Nodes, branch: Branch, profile: Profile, robot: RobotGeometry
) -> Transitions:
    """Return the decisions that led from ``before`` to ``after``, row by row.

    ``branch`` has the poses in between.
    """
    return Transitions(
        before=before.robots(),
        after=after.robots(),
        pitches=after.pitches,
        action=after.turns,
        previous_action=before.turns,
        path=branch.poses[:, :, :3],
        flippers=branch.poses[:, :, 3:],
        profile=profile,
        robot=robot,
        outcome=_OUTCOMES[branch.outcome].tolist(),
    )


_SPACING = 0.02  # distance between two points of the ground's outline [m]


class Ground:
    """Points along a polyline, vertical faces included, and level ground beyond its ends."""

    def __init__(self, line: FloatArray, layout: ObservationLayout) -> None:
        """``line``: (V, 2) [m], x never decreasing, not empty."""
        length = np.hypot(*np.diff(line, axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(length)])
        at = np.arange(0.0, along[-1] + _SPACING / 2, _SPACING)
        self._x = np.interp(at, along, line[:, 0])
        z = np.interp(at, along, line[:, 1])
        # With running sums, a bin's mean takes two look-ups and a division.
        self._sums = np.concatenate([[0.0], np.cumsum(z)])
        # The last number is for ``reduceat``, which takes no index past the end.
        self._z, self._highest, self._sides = np.append(z, -np.inf), layout.highest, layout.sides
        self._line = line
        self._edges = np.arange(layout.bins + 1) * layout.bin_width - layout.reach

    def observations(self, places: FloatArray, states: FloatArray) -> NDArray[np.float32]:
        """Return the observations at ``places`` (M, 2) in ``states`` (M, ``STATE``), (M, n).

        The height of a bin is the mean of its points; a bin without points has the height of the
        line in its middle.
        """
        edges = places[:, :1] + self._edges  # (M, N + 1)
        index = np.searchsorted(self._x, edges)
        count = np.diff(index, axis=1)
        total = self._sums[index[:, 1:]] - self._sums[index[:, :-1]]
        heights = total / np.maximum(count, 1)
        columns = [heights, self._tops(index)] if self._highest else [heights]
        if not count.all():
            middle = (edges[:, 1:] + edges[:, :-1]) / 2
            level = np.interp(middle, self._line[:, 0], self._line[:, 1])
            columns = [np.where(count == 0, level, column) for column in columns]
        angles = states[:, [FLIPPERS, FLIPPERS + 1, 2]]
        below = places[:, 1:]
        if self._sides:  # equal ones, since a search predicts in the side plane
            columns, angles = 3 * columns, np.insert(angles, 0, 0.0, axis=1)
        return np.column_stack([*(column - below for column in columns), angles]).astype(np.float32)

    def _tops(self, index: NDArray[np.int64]) -> FloatArray:
        """Return the height of the highest point from each index to the next, (M, N) [m].

        It is any number where there is none.
        """
        parts = np.maximum.reduceat(self._z, index.ravel()).reshape(index.shape)
        return parts[:, :-1]
