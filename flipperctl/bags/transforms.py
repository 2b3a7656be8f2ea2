"""Where frames are in each other, over time: what tf2 answers, in numpy.

In: transforms of a child frame in its parent, each with a stamp or fixed. Out: the pose of a frame
in another at a time, interpolated.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from dataclasses import dataclass, field

import numpy as np

from flipperctl.api import FloatArray
from flipperctl.core.lidar.messages import Pose as ChassisPose
from flipperctl.errors import RequestError
from flipperctl.messages import close_match

FARTHEST = 0.25
"""Longest time to the nearest transform [s]."""


@dataclass(frozen=True)
class Pose:
    """A frame in another."""

    place: FloatArray
    """Its origin, (3,) [m]."""
    turn: FloatArray
    """Rotation from it to the other frame, as x, y, z and w, (4,) [-]."""

    @classmethod
    def none(cls) -> Pose:
        """Return the pose of a frame in itself."""
        return cls(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    def apply(self, points: FloatArray) -> FloatArray:
        """Return points of the frame, (P, 3), in the other frame [m]."""
        return self.directions(points) + self.place

    def directions(self, vectors: FloatArray) -> FloatArray:
        """Return vectors of the frame, (P, 3), along the axes of the other frame."""
        from scipy.spatial.transform import Rotation

        turned: FloatArray = Rotation.from_quat(self.turn).apply(vectors)
        return turned

    def after(self, inner: Pose) -> Pose:
        """Return the pose of ``inner``'s frame, which is a pose in this one, in the other frame."""
        from scipy.spatial.transform import Rotation

        both = Rotation.from_quat(self.turn) * Rotation.from_quat(inner.turn)
        return Pose(self.apply(inner.place[None])[0], both.as_quat())

    def inverse(self) -> Pose:
        """Return the pose of the other frame in this one."""
        from scipy.spatial.transform import Rotation

        back = Rotation.from_quat(self.turn).inv()
        return Pose(-back.apply(self.place), back.as_quat())


def estimated(pose: Pose) -> ChassisPose:
    """Return the chassis in a fixed frame as the estimator takes it."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(pose.turn).as_matrix()
    x, y, z = pose.place.tolist()
    forward, left = turn[:, 0].tolist(), turn[:, 1].tolist()
    roll, pitch = (math.asin(min(1.0, max(-1.0, axis[2]))) for axis in (left, forward))
    return ChassisPose(x, y, z, roll, pitch, math.atan2(forward[1], forward[0]))


@dataclass
class _Track:
    """The poses of a frame in its parent, by time."""

    parent: str
    fixed: Pose | None = None
    times: list[float] = field(default_factory=list)
    poses: dict[float, Pose] = field(default_factory=dict)

    def add(self, time: float, pose: Pose) -> None:
        if time not in self.poses:
            insort(self.times, time)
        self.poses[time] = pose

    def at(self, time: float) -> Pose | None:
        """Return the pose at a time; None if the nearest one is too far away."""
        if self.fixed is not None:
            return self.fixed
        after = bisect_left(self.times, time)
        if after < len(self.times) and self.times[after] == time:
            return self.poses[time]
        around = self.times[max(0, after - 1) : after + 1]
        nearest = min(around, key=lambda one: abs(one - time))
        if abs(nearest - time) > FARTHEST:
            return None
        return (
            self.poses[nearest] if len(around) == 1 else self._between(around[0], around[1], time)
        )

    def _between(self, before: float, after: float, time: float) -> Pose:
        part = (time - before) / (after - before)
        first, second = self.poses[before], self.poses[after]
        # Of the two quaternions of a rotation, the one on the side of the first.
        near = second.turn if first.turn @ second.turn >= 0 else -second.turn
        turn = (1 - part) * first.turn + part * near
        place = (1 - part) * first.place + part * second.place
        return Pose(place, turn / np.linalg.norm(turn))


class Transforms:
    """A tree of frames; each frame has one parent."""

    def __init__(self) -> None:
        self._tracks: dict[str, _Track] = {}

    def add(self, parent: str, child: str, time: float | None, pose: Pose) -> None:
        """Add the pose of ``child`` in ``parent`` at a time [s]; None if it is fixed."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        track = self._tracks.setdefault(child, _Track(parent))
        track.parent = parent
        if time is None:
            track.fixed = pose
        else:
            track.add(time, pose)

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        return sorted({*self._tracks, *(track.parent for track in self._tracks.values())})

    def has(self, child: str) -> bool:
        """Return whether the pose of a frame in its parent is known."""
        return child.lstrip("/") in self._tracks

    def pose(self, frame: str, of: str, time: float) -> Pose | None:
        """Return the pose of the frame ``of`` in ``frame``; None if it is unknown at that time.

        Raises:
            RequestError: one of them is no frame, or nothing connects them.
        """
        for name in (frame, of):
            if name not in self.frames:
                raise RequestError(
                    f"there is no frame {name!r}{close_match(name, self.frames)}; frames with a "
                    f"transform: {', '.join(self.frames) or 'none'}"
                )
        ours, theirs = self._above(frame), self._above(of)
        common = [name for name in ours if name in theirs]
        if not common:
            raise RequestError(f"nothing connects the frames {frame!r} and {of!r}")
        up = self._within(theirs[: theirs.index(common[0])], time)
        down = self._within(ours[: ours.index(common[0])], time)
        return None if up is None or down is None else down.inverse().after(up)

    def _above(self, frame: str) -> list[str]:
        """Return the frame, its parent, and so on."""
        found = [frame]
        while (track := self._tracks.get(found[-1])) and track.parent not in found:
            found.append(track.parent)
        return found

    def _within(self, chain: list[str], time: float) -> Pose | None:
        """Return the pose of the first frame of a chain in the parent of its last."""
        total = Pose.none()
        for name in chain:
            pose = self._tracks[name].at(time)
            if pose is None:
                return None
            total = pose.after(total)
        return total
