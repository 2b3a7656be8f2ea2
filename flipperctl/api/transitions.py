"""Many decisions in arrays, so that reward terms compute all of them at once.

In: ``Transition`` objects, or the arrays of a prediction. Out: the arrays by the same names, and
each decision as a ``Transition``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from flipperctl.api.profile import Profile
from flipperctl.api.values import Outcome, RobotGeometry, RobotState, Transition
from flipperctl.core import FloatArray

LAST_PITCHES = 8
"""Number of last pitches that a search passes at least, unless the episode has fewer [-]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotStates:
    """The robot at M instants; each array has the meaning of the ``RobotState`` field's name."""

    flippers: ClassVar[tuple[float, ...]] = ()
    """Of pairs, as predictions have them."""

    position: FloatArray
    """World coordinates (x, z) of the chassis centre, (M, 2) [m]."""
    pitch: FloatArray
    """(M,) [rad]"""
    front: FloatArray
    """(M,) [rad]"""
    rear: FloatArray
    """(M,) [rad]"""
    velocity: FloatArray
    """Velocity (x, z) of the chassis centre in world, (M, 2) [m/s]."""
    pitch_rate: FloatArray
    """(M,) [rad/s]"""
    time: FloatArray
    """Time since the start of the episode, (M,) [s]."""
    roll: FloatArray = field(default_factory=lambda: np.zeros(()))
    """(M,) [rad]; one number stands for all"""
    yaw: FloatArray = field(default_factory=lambda: np.zeros(()))
    """(M,) [rad]; one number stands for all"""
    side: FloatArray = field(default_factory=lambda: np.zeros(()))
    """World y of the chassis centre, (M,) [m]; one number stands for all."""

    def __post_init__(self) -> None:
        for name in ("roll", "yaw", "side"):
            if (value := getattr(self, name)).shape != self.pitch.shape:
                object.__setattr__(self, name, np.broadcast_to(value, self.pitch.shape))
        for name, width in _STATE.items():
            _require_shape(name, getattr(self, name), (len(self), *width))

    @classmethod
    def of(cls, states: Sequence[RobotState]) -> RobotStates:
        """Return the states in arrays."""
        numbers = np.array([_numbers(s) for s in states], np.float64).T.copy()
        return cls(
            position=np.array([s.position for s in states], np.float64),
            velocity=np.array([s.velocity for s in states], np.float64),
            **dict(zip(_NUMBERS, numbers, strict=True)),
        )

    def take(self, rows: NDArray[np.intp]) -> RobotStates:
        """Return some of the states."""
        return RobotStates(**{name: getattr(self, name)[rows] for name in _STATE})

    def __len__(self) -> int:
        return len(self.position)

    def __iter__(self) -> Iterator[RobotState]:
        return iter(self._rows)

    def __getitem__(self, index: int) -> RobotState:
        return self._rows[index]

    @cached_property
    def _rows(self) -> tuple[RobotState, ...]:
        # tolist() makes Python numbers, as a single state has them.
        columns = {
            name: getattr(self, name) if width else getattr(self, name).tolist()
            for name, width in _STATE.items()
        }
        rows = zip(*columns.values(), strict=True)
        return tuple(RobotState(**dict(zip(columns, row, strict=True))) for row in rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class Transitions:
    """M decisions on one ground, of one robot, in arrays; ``ts[i]`` is one as a ``Transition``.

    The arrays must not be changed: single transitions are views of them.

    Raises:
        ValueError: an array has another shape than its field says.
    """

    before: RobotStates
    after: RobotStates
    pitches: FloatArray
    """Pitch at the last T decisions of the episode up to ``after``, (M, T) [rad].

    A search passes at least the last ``LAST_PITCHES``; at the start of an episode there are fewer,
    and then all rows have equally few.
    """
    action: NDArray[np.intp]
    """Turn of each joint, in {-1, 0, 1}, (M, J)."""
    previous_action: NDArray[np.intp]
    """Actions of the previous decisions; 0 at the first decision of an episode, (M, J)."""
    path: FloatArray
    """Poses of the chassis from ``before`` to ``after``, (M, S + 1, 3): x [m], z [m], pitch [rad].

    M × 0 × 3 if the poses in between are not known.
    """
    flippers: FloatArray
    """Angle of each joint in frame R at each pose of ``path``, (M, S + 1, J) [rad]."""
    profile: Profile
    robot: RobotGeometry
    outcome: Sequence[Outcome | None]
    """How each episode ended, (M,); None while it runs."""
    sample_period: float = 0.01
    """Time between two poses of ``path`` [s]."""

    def __post_init__(self) -> None:
        count, poses, joints = len(self.after), self.path.shape[1:2], self.action.shape[1:]
        _require_shape("before.pitch", self.before.pitch, (count,))
        _require_shape("pitches", self.pitches, (count, self.pitches.shape[-1]))
        shapes = {"path": (*poses, 3), "flippers": (*poses, *joints)}
        for name in _ARRAYS:
            _require_shape(name, getattr(self, name), (count, *shapes.get(name, joints)))
        if len(self.outcome) != count:
            raise ValueError(f"outcome has {len(self.outcome)} entries; {count} are allowed")

    @classmethod
    def of(cls, transitions: Sequence[Transition]) -> Transitions:
        """Return transitions in arrays, each with as many last pitches as the shortest has.

        Raises:
            ValueError: there is none, or ground, robot, sample period or length of the path differ.
        """
        if not transitions:
            raise ValueError("there is no transition; one at least is allowed")
        first, shortest = transitions[0], min(len(t.pitches) for t in transitions)
        # Terms compute all rows at once, on one ground, of one robot, with paths of one length.
        for t in transitions[1:]:
            same_ground = np.array_equal(t.profile.points, first.profile.points)
            same_robot = t.robot == first.robot and t.sample_period == first.sample_period
            if not (same_ground and same_robot and t.path.shape == first.path.shape):
                raise ValueError(
                    "transitions differ in ground, robot, sample period or length of the path; "
                    "in arrays only equal ones are allowed"
                )
        return cls(
            before=RobotStates.of([t.before for t in transitions]),
            after=RobotStates.of([t.after for t in transitions]),
            pitches=np.array([t.pitches[len(t.pitches) - shortest :] for t in transitions]),
            profile=first.profile,
            robot=first.robot,
            outcome=tuple(t.outcome for t in transitions),
            sample_period=first.sample_period,
            **{
                name: np.array([getattr(t, name) for t in transitions], kind)
                for name, kind in _ARRAYS.items()
            },
        )

    def __len__(self) -> int:
        return len(self.after)

    def __iter__(self) -> Iterator[Transition]:
        return iter(self._rows)

    def __getitem__(self, index: int) -> Transition:
        return self._rows[index]

    def ending(self, rows: NDArray[np.intp], outcome: Outcome) -> Transitions:
        """Return some of the decisions as if each had ended its episode with ``outcome``."""
        return replace(
            self,
            before=self.before.take(rows),
            after=self.after.take(rows),
            outcome=(outcome,) * len(rows),
            **{name: getattr(self, name)[rows] for name in ("pitches", *_ARRAYS)},
        )

    @cached_property
    def ended(self) -> NDArray[np.bool_]:
        """Whether each decision ended its episode, (M,)."""
        return np.fromiter((o is not None for o in self.outcome), np.bool_, len(self))

    @cached_property
    def reached(self) -> NDArray[np.bool_]:
        """Whether each decision reached the finish, (M,)."""
        return np.fromiter((o is Outcome.REACHED for o in self.outcome), np.bool_, len(self))

    @cached_property
    def _rows(self) -> tuple[Transition, ...]:
        """The decisions one by one, made when the first term without an array form asks."""
        actions, previous = self.action.tolist(), self.previous_action.tolist()
        return tuple(
            Transition(
                before=before,
                after=after,
                pitches=self.pitches[i],
                action=tuple(actions[i]),
                profile=self.profile,
                robot=self.robot,
                outcome=self.outcome[i],
                path=self.path[i],
                previous_action=tuple(previous[i]),
                flippers=self.flippers[i],
                sample_period=self.sample_period,
            )
            for i, (before, after) in enumerate(zip(self.before, self.after, strict=True))
        )


_STATE: dict[str, tuple[int, ...]] = {
    "position": (2,),
    "pitch": (),
    "front": (),
    "rear": (),
    "velocity": (2,),
    "pitch_rate": (),
    "time": (),
    "roll": (),
    "yaw": (),
    "side": (),
}
"""Field of ``RobotState`` → shape of its value."""
_ARRAYS: dict[str, type] = {
    "action": np.intp,
    "previous_action": np.intp,
    "path": np.float64,
    "flippers": np.float64,
}
"""Field of ``Transition`` → type of its numbers."""
_NUMBERS = tuple(name for name, shape in _STATE.items() if not shape)
_numbers = attrgetter(*_NUMBERS)


def _require_shape(name: str, array: FloatArray | NDArray[np.intp], shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise ValueError(f"{name} has the shape {array.shape}; {shape} is allowed")
