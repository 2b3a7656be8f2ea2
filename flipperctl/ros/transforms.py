"""Where frames are in each other, over time: what tf2 answers, in numpy.

In: transforms of a child frame in its parent, each with a stamp or fixed. Out: the pose of a frame
in another at a time, interpolated.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

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
        turned: FloatArray = Rotation.from_quat(self.turn).apply(vectors)
        return turned

    def after(self, inner: Pose) -> Pose:
        """Return the pose of ``inner``'s frame, which is a pose in this one, in the other frame."""
        both = Rotation.from_quat(self.turn) * Rotation.from_quat(inner.turn)
        return Pose(self.apply(inner.place[None])[0], both.as_quat())

    def near(self, other: Pose) -> bool:
        """Return whether another pose is the same within a millimetre and a thousandth."""
        turned = 1 - abs(float(self.turn @ other.turn))  # of unit quaternions: 1 - cos(angle / 2)
        return bool(np.linalg.norm(self.place - other.place) <= 1e-3 and turned <= 1e-6)

    def inverse(self) -> Pose:
        """Return the pose of the other frame in this one."""
        back = Rotation.from_quat(self.turn).inv()
        return Pose(-back.apply(self.place), back.as_quat())


def estimated(pose: Pose) -> ChassisPose:
    """Return the chassis in a fixed frame as the estimator takes it."""
    turn = Rotation.from_quat(pose.turn).as_matrix()
    x, y, z = pose.place.tolist()
    forward, left = turn[:, 0].tolist(), turn[:, 1].tolist()
    roll, pitch = (math.asin(min(1.0, max(-1.0, axis[2]))) for axis in (left, forward))
    return ChassisPose(x, y, z, roll, pitch, math.atan2(forward[1], forward[0]))


@dataclass
class _Track:
    """The poses of a frame in its parent, by time."""

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
        if len(around) == 1:
            return self.poses[nearest]
        part = (time - around[0]) / (around[1] - around[0])
        first, second = (self.poses[one] for one in around)
        # Of the two quaternions of a rotation, the one on the side of the first.
        near = second.turn if first.turn @ second.turn >= 0 else -second.turn
        turn = (1 - part) * first.turn + part * near
        place = (1 - part) * first.place + part * second.place
        return Pose(place, turn / np.linalg.norm(turn))


_Link = tuple[str, str]
"""A frame and one of its parents."""


class Transforms:
    """A tree of frames, or several that share a frame: a frame may have several parents."""

    def __init__(self, source: Path | None = None) -> None:
        """``source``: the recording, for errors."""
        self._where = "" if source is None else f"{source}: "
        self._tracks: dict[str, dict[str, _Track]] = {}  # child → parent → its poses
        self._known: dict[_Link, list[tuple[list[_Link], list[_Link]]]] = {}

    def add(self, parent: str, child: str, time: float | None, pose: Pose) -> None:
        """Add the pose of ``child`` in ``parent`` at a time [s]; None if it is fixed."""
        tracks = self._tracks.setdefault(child.lstrip("/"), {})
        if parent.lstrip("/") not in tracks:
            self._known.clear()
        track = tracks.setdefault(parent.lstrip("/"), _Track())
        if time is None:
            track.fixed = pose
        else:
            track.add(time, pose)

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        parents = (name for tracks in self._tracks.values() for name in tracks)
        return sorted({*self._tracks, *parents})

    def has(self, child: str) -> bool:
        """Return whether the pose of a frame in a parent is known."""
        return child.lstrip("/") in self._tracks

    def remarks(self, fixed: str, base: str) -> list[str]:
        """Return what a reader of the poses of ``base`` in ``fixed`` should know."""
        parents = sorted(self._tracks.get(base, ()))
        if len(parents) < 2:
            return []
        return [
            f"{base} has {len(parents)} parents, {' and '.join(parents)}: its poses are those in "
            f"{fixed} (--fixed-frame)"
        ]

    def pose(self, frame: str, of: str, time: float) -> Pose | None:
        """Return the pose of the frame ``of`` in ``frame``; None if it is unknown at that time.

        Of several parents, the one counts that leads to ``frame``.

        Raises:
            RequestError: one of them is no frame, nothing connects them, or two ways do, which
                differ.
        """
        frame, of = frame.lstrip("/"), of.lstrip("/")
        told: list[tuple[list[_Link], Pose]] = []
        for up, down in self._ways(frame, of):
            ours, theirs = self._along(down, time), self._along(up, time)
            if ours is not None and theirs is not None:
                told.append(([*up, *down], ours.inverse().after(theirs)))
        for way, pose in told[1:]:
            if not told[0][1].near(pose):
                one = told[0][0]
                child, first = next(link for link in one if link not in way)
                second = next((parent for name, parent in way if name == child), way[0][1])
                raise RequestError(
                    f"{self._where}{child!r} has two parents, {first!r} and {second!r}, by which "
                    f"the poses of {of!r} in {frame!r} differ; a recording with one of them is "
                    "needed"
                )
        return told[0][1] if told else None

    def on(self, base: str, frame: str, time: float) -> Pose | None:
        """Return the pose of a device's frame on the chassis, which needs no transform itself."""
        same = frame.lstrip("/") == base
        return Pose.none() if same else self.pose(base, frame, time)

    def _ways(self, frame: str, of: str) -> list[tuple[list[_Link], list[_Link]]]:
        """Return the links from ``of`` up to a frame above both, and from ``frame`` up to it.

        Ways that only climb, or only descend, come before those that do both.
        """
        if (frame, of) not in self._known:
            for name in (frame, of):
                if name not in self.frames:
                    hint, known = close_match(name, self.frames), ", ".join(self.frames) or "none"
                    raise RequestError(
                        f"{self._where}there is no frame {name!r}{hint}; frames with a transform: "
                        f"{known}"
                    )
            ways = []
            above = list(self._above(frame))
            for up in self._above(of):
                passed = {of, *(parent for _, parent in up)}
                for down in above:
                    top = down[-1][1] if down else frame
                    others = {frame, *(parent for _, parent in down)} - {top}
                    if top == (up[-1][1] if up else of) and not others & passed:
                        ways.append((up, down))
            if not ways:
                raise RequestError(f"{self._where}nothing connects the frames {frame!r} and {of!r}")
            straight = [way for way in ways if not (way[0] and way[1])]
            self._known[frame, of] = straight or ways
        return self._known[frame, of]

    def _above(self, frame: str, passed: tuple[_Link, ...] = ()) -> Iterator[list[_Link]]:
        """Yield the links to each frame above a frame, on each way, and none to itself."""
        yield list(passed)
        for parent in sorted(self._tracks.get(frame, ())):
            if parent not in {frame, *(child for child, _ in passed)}:
                yield from self._above(parent, (*passed, (frame, parent)))

    def _along(self, links: list[_Link], time: float) -> Pose | None:
        """Return the pose of the first frame of a chain of links in the last one."""
        total = Pose.none()
        for child, parent in links:
            pose = self._tracks[child][parent].at(time)
            if pose is None:
                return None
            total = pose.after(total)
        return total
