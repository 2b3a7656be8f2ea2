"""Scan matching: the motion between a scan and earlier ones, with small_gicp's search trees.

In: level points around the robot and a guess of its position. Out: the corrected position and turn.

Points of a scan are matched to planes through the points of earlier scans, the keyframes, by
Gauss-Newton steps for translation and heading. Roll and pitch are left to the inertial unit. The
guess by odometry counts too, as far as belts may have slipped since the last scan, and directions
that the points do not determine keep it. Matching point to point would align the rings of the scans
with each other, which move with the robot. A keyframe is added only after some motion, since each
one that is matched adds its error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from flipperctl.core import FloatArray

_FAR = 6.0  # farthest points that are matched [m]
_THIN, _THINNER = 0.06, 0.12
"""Size of the cells in which a keyframe and a scan that is matched keep one point [m]."""
_NEIGHBOURS = 12  # points by which the plane through a point of a keyframe is found [-]
_KEYFRAMES = 12  # keyframes that are remembered [-]
_NEXT = 0.25, 0.15  # motion [m] and change of the view [rad] after which a scan becomes a keyframe
_GATE = 0.01
"""Share of the information below which a direction is not corrected, and twice which it is wholly:
on level ground no point tells how far the robot has moved [-]."""
_PAIRED = 0.2  # largest distance of a point from the one to whose plane it is matched [m]
_LARGEST = 0.3  # largest correction [m]
_MOST = 5000  # from so many points on, some are left out [-]
_FEWEST = 100  # points without which a scan is not matched [-]
_ERROR, _SHARED = 0.02, 10.0
"""Deviation of a point from its plane [m], and points that err alike [-]."""
_SLIP, _STEEP, _JITTER, _TURN = 0.05, 0.5, 0.001, 2e-4
"""Deviation of the guess: per way, per way and sine of the pitch [-], since belts hardly slip on
level ground; of any scan [m], and of the turn between two scans [rad]. Larger corrections are
weighted as outliers: belts that do slip may slip wholly."""
_SINKING, _LIFTED = 2.0, 0.7
"""Deviations of the guess along the ground and upwards, per error of its height: belts slip where
the robot tips over an edge or sinks with its flippers, and both show in its height. Without the
second, motion along a slope would explain that the robot was lifted [-]."""
_STEPS = 5  # largest number of Gauss-Newton steps [-]
_ENOUGH = 2e-4  # steps shorter than this are the last [m]


@dataclass(frozen=True)
class Keyframe:
    """Points of an earlier scan with the planes through them."""

    points: FloatArray  # (P, 3) in frame M [m]
    normals: FloatArray  # (P, 3) unit normals; 0 where there is no plane


class ScanMatcher:
    """Corrects positions by the keyframes that it remembers."""

    def __init__(self) -> None:
        """Raise ``ImportError`` if small_gicp is not installed."""
        import small_gicp

        self._library = small_gicp
        self._keyframes: tuple[Keyframe, ...] = ()
        self._latest: FloatArray | None = None  # position after the last scan [m]
        self._entered: FloatArray | None = None  # position and direction of the newest keyframe
        self._target: tuple[Keyframe, Any] | None = None  # all keyframes, and their search tree

    def corrected(
        self, points: FloatArray, guess: FloatArray, facing: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the position, (3,) in frame M [m], and by how much the heading turns [rad].

        ``points`` (P, 3) of the scan are relative to the robot, in the directions of frame M [m].
        ``guess`` is the position by odometry, and ``facing`` (3,) the direction of the chassis.
        """
        # Near points, at most so many
        x, y, z = points.T
        near = points.compress(x * x + y * y + z * z < _FAR**2, axis=0)
        near = near[:: 1 + len(near) // _MOST]
        if len(near) < _FEWEST:
            self._latest = guess
            return guess, 0.0

        # The guess stays where no keyframe tells otherwise.
        position, turn = guess, 0.0
        if self._keyframes:
            slip = _SLIP + _STEEP * abs(float(facing[2]))
            position, turn = self._matched(near, guess, slip)
        self._latest = position
        view = np.concatenate([position, facing])
        if self._is_new(view):
            self._entered = view
            self._remember(_turned(near, turn), position)
        return position, turn

    def _is_new(self, view: FloatArray) -> bool:
        if self._entered is None:
            return True
        moved, turned = view[:3] - self._entered[:3], view[3:] - self._entered[3:]
        return bool(np.linalg.norm(moved) > _NEXT[0] or np.linalg.norm(turned) > _NEXT[1])

    def _remember(self, points: FloatArray, position: FloatArray) -> None:
        # Planes are found once for a keyframe, and used for each later scan.
        cloud, _ = self._library.preprocess_points(
            points, downsampling_resolution=_THIN, num_neighbors=_NEIGHBOURS
        )
        at = np.asarray(cloud.points())[:, :3] + position
        frame = Keyframe(at, np.array(cloud.normals())[:, :3])
        self._keyframes = (*self._keyframes, frame)[-_KEYFRAMES:]
        self._target = None

    def _matched(
        self, points: FloatArray, guess: FloatArray, slip: float
    ) -> tuple[FloatArray, float]:
        """Return position and turn of a scan by the keyframes; the guess if they do not tell.

        ``slip``: deviation of the guess per way since the last scan [-].
        """
        # One tree over all keyframes
        if self._target is None:
            known = [
                np.concatenate([getattr(frame, part) for frame in self._keyframes])
                for part in ("points", "normals")
            ]
            self._target = Keyframe(*known), self._library.KdTree(known[0])
        target, tree = self._target

        # Fewer points, and how far the guess may err by the way since the last scan
        thin = np.asarray(self._library.voxelgrid_sampling(points, _THINNER).points())[:, :3]
        way = 0.0 if self._latest is None else float(np.linalg.norm(guess - self._latest))
        usual = _JITTER + slip * way
        likely = np.array([usual] * 3 + [_TURN])
        off = np.zeros(4)  # correction of the position, turn

        # Pairs are sought anew in each step, since the points move.
        for _ in range(_STEPS):
            level = _turned(thin, off[3])
            placed = level + (guess + off[:3])
            pairs, squares = tree.batch_nearest_neighbor_search(placed)
            close = np.asarray(squares) < _PAIRED**2
            if close.sum() < _FEWEST:
                return guess, 0.0
            pairs = np.asarray(pairs)[close]
            level, placed = (where.compress(close, axis=0) for where in (level, placed))
            step = _step(level, placed, target, pairs, off, likely)
            off = off + step
            slipped = np.sqrt(usual * np.maximum(usual, np.abs(off[:3])))  # Huber's weights
            likely[:3] = slipped + np.array([_SINKING, _SINKING, _LIFTED]) * abs(off[2])
            if np.linalg.norm(step[:3]) < _ENOUGH:
                break
        if not np.linalg.norm(off[:3]) <= _LARGEST:
            return guess, 0.0
        return guess + off[:3], float(off[3])

    def save(self) -> tuple[Any, ...]:
        """Return a snapshot, which later scans do not change."""
        return self._keyframes, self._latest, self._entered

    def load(self, saved: tuple[Any, ...]) -> None:
        """Restore a snapshot."""
        keyframes, self._latest, self._entered = saved
        if keyframes is not self._keyframes:
            self._keyframes, self._target = keyframes, None


def _step(
    level: FloatArray,
    placed: FloatArray,
    target: Keyframe,
    pairs: Any,
    off: FloatArray,
    likely: FloatArray,
) -> FloatArray:
    """Return a Gauss-Newton step, (4,): translation [m] and turn [rad].

    ``level`` (P, 3): points relative to the robot; ``placed``: the same in frame M; ``pairs`` (P,):
    indices of the points whose planes they are matched to. ``off`` (4,): the correction so far;
    ``likely`` (4,): its standard deviations by odometry.
    """
    # The distances to the planes, and how they change with a motion
    normals = target.normals.take(pairs, axis=0)
    apart = placed - target.points.take(pairs, axis=0)
    away = np.einsum("ij,ij->i", normals, apart)
    turning = normals[:, 1] * level[:, 0] - normals[:, 0] * level[:, 1]
    slopes = np.column_stack([normals, turning])  # (P, 4) of the distances to the planes

    # Outliers count less, and points that err alike count as one.
    weights = 1.0 / np.maximum(1.0, np.abs(away) / _ERROR) / (_ERROR**2 * _SHARED)  # Huber's
    information = slopes.T @ (slopes * weights[:, None])
    pull = -slopes.T @ (weights * away)

    # Directions that the points do not determine keep the guess.
    keep = np.eye(4)
    keep[:3, :3] = determined(information[:3, :3])
    prior = np.diag(1.0 / likely**2)
    total = keep @ information @ keep + prior
    return np.asarray(np.linalg.solve(total, keep @ pull - prior @ off))


def determined(information: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) that keeps the parts of a vector that the points determine.

    ``information``: (3, 3) information matrix of the translation, in any unit.
    """
    # Directions with a small share of the information are not corrected, with a ramp in between.
    eigenvalues, axes = np.linalg.eigh(information)
    share = eigenvalues / max(1e-9, float(eigenvalues.sum()))
    weight = np.clip((share - _GATE) / _GATE, 0.0, 1.0)
    return np.asarray((axes * weight) @ axes.T)


def _turned(points: FloatArray, turn: float) -> FloatArray:
    """Return ``points`` (P, 3) turned about the vertical axis by ``turn`` [rad]."""
    if not turn:
        return points
    cos, sin = math.cos(turn), math.sin(turn)
    return np.asarray(points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]))
