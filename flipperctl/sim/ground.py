"""The ground as tracks feel it: thinned, bounded in size, and with a robot at rest on it.

In: a generated profile. Out: a profile that feels the same to the tracks and is cheap to simulate.
Also the height and the pitch of a chassis that rests on it, on level ground, a slope or a stair.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Profile, Robot, Start
from flipperctl.api.jit import cached
from flipperctl.core import ground_map

kept_points = cached(njit)(ground_map.kept_points)


TOLERANCE = 1e-4
"""Largest distance by which thinning may move the ground that a track feels [m].

The engine lets bodies in contact overlap by as much (``collision_slop``); less cannot be felt.
"""

FINE = 0.01
"""Only a point whose two neighbours are less than this apart in x may be omitted [m].

A vertical face of at least this height keeps both ends.
"""

FEW = 1000
"""A profile with at most this number of points is not thinned."""

MOST = 50_000
"""Largest number of points after thinning: 250 m of ground at 5 mm, whose reset takes 1 s."""

LONGEST = 2000.0
"""Largest length of an outline [m], almost three hours of driving at 0.2 m/s."""


def thinned(profile: Profile, track_radius: float) -> Profile:
    """Return the profile without points that a track of this radius [m] cannot feel.

    A point is omitted if it lies within ``TOLERANCE`` of the line that replaces it. So is one in a
    hollow so narrow that a round end of radius r sinks into it by less than ``TOLERANCE``. Between
    two edges at distance d it sinks by d²/8r; d is 9 mm at a radius of 0.1 m. The first and the
    last point and all ground that is not fine are kept. If no point is omitted, the profile itself
    is returned. Its surface stays as it is.
    """
    if len(profile.points) <= FEW:
        return profile

    # A round end sinks by d²/8r between two edges at distance d; solved for d at the tolerance.
    span = math.sqrt(8 * track_radius * TOLERANCE)
    keep = kept_points(profile.points, _fixed(profile.points), TOLERANCE, span)
    if keep.all():
        return profile
    return replace(profile, points=profile.points[keep])


def check_extent(profile: Profile) -> None:
    """Check that the ground needs an acceptable amount of time and memory.

    Raises:
        ValueError: the profile has too many points or is too long.
    """
    if (count := len(profile.points)) > MOST:
        raise ValueError(
            f"the profile has {count} points after thinning to {TOLERANCE * 1000:g} mm; at most "
            f"{MOST} are allowed: cut it or sample it more coarsely"
        )
    with np.errstate(over="ignore"):  # an overflowing length is too long
        length = float(np.hypot(*np.diff(profile.points, axis=0).T).sum())
    if length > LONGEST:
        raise ValueError(
            f"the profile's outline is {length:.4g} m long; at most {LONGEST:g} m are allowed "
            "(is its unit metres?)"
        )


def _fixed(points: FloatArray) -> NDArray[np.bool_]:
    """Return which points thinning must keep, (V,)."""
    x, z = points.T
    fixed = np.ones(len(points), dtype=np.bool_)
    # Coarse ground stays: only a point in a finely sampled stretch may be omitted.
    fixed[1:-1] = x[2:] - x[:-2] >= FINE
    # Runs of equal x are vertical faces.
    begins = np.flatnonzero(np.concatenate([[True], np.diff(x) > 0]))
    ends = np.append(begins[1:], len(x)) - 1
    faces = np.abs(z[ends] - z[begins]) >= FINE
    fixed[begins[faces]] = fixed[ends[faces]] = True
    return fixed


@cached(njit)
def inflated(
    line: FloatArray, origin: float, spacing: float, count: int, radius: float
) -> FloatArray:
    """Return the lowest heights of a circle's centre above a polyline, (count,) [m].

    The circle has ``radius`` [m]; its centre is at ``origin`` and every ``spacing`` [m] past it.
    ``line`` is (V, 2) [m] with x that never decreases.
    """
    heights = np.full(count, -np.inf)
    # A segment lifts only those centres that are within a radius of it.
    for i in range(len(line) - 1):
        x0, z0, x1, z1 = line[i, 0], line[i, 1], line[i + 1, 0], line[i + 1, 1]
        slope = (z1 - z0) / (x1 - x0) if x1 > x0 else 0.0
        steep = math.sqrt(1 + slope * slope)
        low = max(0, math.ceil((x0 - radius - origin) / spacing))
        high = min(count - 1, math.floor((x1 + radius - origin) / spacing))
        for j in range(low, high + 1):
            x = origin + j * spacing
            # The circle rests on the segment's face if the point of contact lies between its ends.
            touched = x + radius * slope / steep
            height = -np.inf
            if x0 < touched < x1:
                height = z0 + slope * (touched - x0) + radius / steep
            # Else it may rest on one of the two corners.
            if abs(x - x0) <= radius:
                height = max(height, z0 + math.sqrt(radius * radius - (x - x0) ** 2))
            if abs(x - x1) <= radius:
                height = max(height, z1 + math.sqrt(radius * radius - (x - x1) ** 2))
            heights[j] = max(heights[j], height)
    return heights


OVERLAP = 0.005
"""Largest overlap of the robot with the ground at the start [m]."""
_GRID = 0.001  # distance of the places at which the ground is known [m]
_ALONG = 0.002  # distance of the points at which a track is compared with the ground [m]
_ANGLE = math.radians(1.0)
"""Distance of the pitches among which the resting ones are looked for [rad]."""
_HALVINGS = 24  # number of times that the distance of two pitches is halved, to 1e-9 rad


def height_at(start: Start, profile: Profile, robot: Robot) -> float:
    """Return world z of the chassis centre at the start [m].

    Without a height of its own, the robot rests level on the lower flippers or on the chassis.
    """
    if start.height is not None:
        return start.height
    below = max(0.0, -math.sin(start.front), -math.sin(start.rear))
    return profile.height(start.x) + (robot.track_radius + robot.flipper_axle * below)


def resting(
    profile: Profile, robot: Robot, x: float, front: float, rear: float, steepest: float
) -> tuple[float, float] | None:
    """Return world z [m] and pitch [rad] of a chassis that rests with its centre above ``x`` [m].

    ``front`` and ``rear`` are the flippers' angles in frame R [rad]. The robot touches the ground
    ahead of its centre of mass and behind it, which friction has to hold. Among several such
    pitches within ± ``steepest`` [rad], the lowest centre of mass decides. None: there is none.
    """
    ground = _Ground.around(profile, robot, x, front, rear)
    turns = math.floor(steepest / _ANGLE)
    pitches = _ANGLE * np.arange(-turns, turns + 1, dtype=np.float64)
    # Rest is stable where the contact moves from ahead of the centre of mass to behind it as the
    # pitch grows.
    _, masses, levers = ground.supports(pitches)
    (rests,) = np.nonzero((levers[:-1] >= 0) & (levers[1:] < 0))
    if not len(rests):
        return None
    # The lowest of these pitches is refined by bisection.
    first = rests[masses[rests].argmin()]
    low, high = float(pitches[first]), float(pitches[first + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        _, _, lever = ground.supports(np.array([middle]))
        low, high = (middle, high) if lever[0] >= 0 else (low, middle)
    heights, _, _ = ground.supports(np.array([low]))
    return float(heights[0]), low


@dataclass(frozen=True)
class _Ground:
    """The ground around a robot whose centre is above ``x``, as its tracks touch it."""

    robot: Robot
    x: float  # world x of the chassis centre [m]
    front: float
    rear: float  # angles of the flippers in frame R [rad]
    places: FloatArray  # world x of centres of the tracks' round ends, (G,) [m]
    above: FloatArray  # lowest world z of these centres, (G,) [m]
    contacts: FloatArray  # world x where they then touch the ground, (G,) [m]

    @classmethod
    def around(cls, profile: Profile, robot: Robot, x: float, front: float, rear: float) -> _Ground:
        """Return the ground within the robot's reach."""
        reach = robot.hinge_offset + robot.flipper_axle + 2 * _GRID
        margin = reach + robot.track_radius
        # The line reaches as far as the flippers do, with level ground past its ends.
        line = profile.extended(margin + abs(x - profile.start), margin + abs(x - profile.end))
        count = math.ceil(2 * reach / _GRID) + 1
        places = x - reach + _GRID * np.arange(count, dtype=np.float64)
        above = inflated(line, x - reach, _GRID, count, robot.track_radius)
        # A round end touches the ground along the normal of the path of its centre.
        slopes: FloatArray = np.arctan(np.gradient(above, _GRID))
        contacts: FloatArray = places + robot.track_radius * np.sin(slopes)
        return cls(robot, x, front, rear, places, above, contacts)

    def supports(self, pitches: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what holds the robot up at each pitch (P,) [rad], as low as it can be.

        Three arrays (P,) [m]: height of the chassis centre, height of the centre of mass, and how
        far the contact lies ahead of the centre of mass.
        """
        robot, front, rear = self.robot, pitches + self.front, self.rear - pitches
        ahead, up = _axes(robot, pitches, front, rear)
        # The point of an axis that needs the highest chassis is the one that carries the robot.
        needed = np.interp(self.x + ahead, self.places, self.above) - up
        at = needed.argmax(axis=1)[:, None]
        heights = np.take_along_axis(needed, at, axis=1)[:, 0]
        touching = self.x + np.take_along_axis(ahead, at, axis=1)[:, 0]
        contacts = np.interp(touching, self.places, self.contacts)
        # The flippers' masses act at the middle between hinge and tip.
        arm = robot.flipper_mass * robot.flipper_axle / 2 / robot.mass
        masses = heights + arm * (np.sin(front) + np.sin(rear))
        levers = contacts - self.x - arm * (np.cos(front) - np.cos(rear))
        # A load moves the chassis' own centre of mass.
        if robot.payload:
            share = robot.carried_mass / robot.mass
            x, z = (share * place for place in robot.centre_of_mass)  # in frame R [m]
            masses = masses + x * np.sin(pitches) + z * np.cos(pitches)
            levers = levers - x * np.cos(pitches) + z * np.sin(pitches)
        return heights, masses, levers


def _axes(
    robot: Robot, pitches: FloatArray, front: FloatArray, rear: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return points on the axes of chassis and flippers from the chassis centre, twice (P, S) [m].

    The first are along world x, the second along world z. ``front`` and ``rear`` are the flippers'
    angles above the level, away from the chassis, (P,) [rad].
    """
    half, axle = robot.hinge_offset, robot.flipper_axle
    chassis = np.linspace(-half, half, math.ceil(2 * half / _ALONG) + 1)
    flipper = np.linspace(0.0, axle, math.ceil(axle / _ALONG) + 1)
    cos, sin = np.cos(pitches)[:, None], np.sin(pitches)[:, None]
    ahead = [chassis * cos, half * cos + flipper * np.cos(front)[:, None]]
    ahead.append(-half * cos - flipper * np.cos(rear)[:, None])
    up = [chassis * sin, half * sin + flipper * np.sin(front)[:, None]]
    up.append(-half * sin + flipper * np.sin(rear)[:, None])
    return np.concatenate(ahead, axis=1), np.concatenate(up, axis=1)
