"""The pose in which a robot rests at the start: level, or as a slope or a stair holds it.

In: the ground, the robot, where its centre is and how its flippers are turned. Out: height and
pitch of the chassis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from flipperctl.api import FloatArray, Profile, Robot, Start
from flipperctl.sim.jit import cached


@cached(njit)
def inflated(
    line: FloatArray, origin: float, spacing: float, count: int, radius: float
) -> FloatArray:
    """Return the lowest heights of a circle's centre above a polyline, (count,) [m].

    The circle has ``radius`` [m]; its centre is at ``origin`` and every ``spacing`` [m] past it.
    ``line`` is (V, 2) [m] with x that never decreases.
    """
    found = np.full(count, -np.inf)
    for i in range(len(line) - 1):
        x0, z0, x1, z1 = line[i, 0], line[i, 1], line[i + 1, 0], line[i + 1, 1]
        slope = (z1 - z0) / (x1 - x0) if x1 > x0 else 0.0
        steep = math.sqrt(1 + slope * slope)
        low = max(0, math.ceil((x0 - radius - origin) / spacing))
        high = min(count - 1, math.floor((x1 + radius - origin) / spacing))
        for j in range(low, high + 1):
            x = origin + j * spacing
            touched = x + radius * slope / steep
            height = -np.inf
            if x0 < touched < x1:
                height = z0 + slope * (touched - x0) + radius / steep
            if abs(x - x0) <= radius:
                height = max(height, z0 + math.sqrt(radius * radius - (x - x0) ** 2))
            if abs(x - x1) <= radius:
                height = max(height, z1 + math.sqrt(radius * radius - (x - x1) ** 2))
            found[j] = max(found[j], height)
    return found


OVERLAP = 0.005
"""Largest overlap of the robot with the ground at the start [m]."""
_GRID = 0.001
"""Distance of the places at which the ground is known [m]."""
_ALONG = 0.002
"""Distance of the points at which a track is compared with the ground [m]."""
_ANGLE = math.radians(1.0)
"""Distance of the pitches among which the resting ones are looked for [rad]."""
_HALVINGS = 24
"""Number of times that the distance of two pitches is halved, to 1e-9 rad."""


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
    ahead of its centre of mass and behind it, which friction has to hold; of several such pitches
    within ± ``steepest`` [rad], it is the one with the lowest centre of mass. None: there is none.
    """
    ground = _Ground.around(profile, robot, x, front, rear)
    turns = math.floor(steepest / _ANGLE)
    pitches = _ANGLE * np.arange(-turns, turns + 1, dtype=np.float64)
    _, masses, levers = ground.supports(pitches)
    (rests,) = np.nonzero((levers[:-1] >= 0) & (levers[1:] < 0))
    if not len(rests):
        return None
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
    x: float
    """World x of the chassis centre [m]."""
    front: float
    rear: float
    """Angles of the flippers in frame R [rad]."""
    places: FloatArray
    """World x of centres of the tracks' round ends, (G,) [m]."""
    above: FloatArray
    """Lowest world z of these centres, (G,) [m]."""
    contacts: FloatArray
    """World x where they then touch the ground, (G,) [m]."""

    @classmethod
    def around(cls, profile: Profile, robot: Robot, x: float, front: float, rear: float) -> _Ground:
        """Return the ground within the robot's reach."""
        reach = robot.hinge_offset + robot.flipper_axle + 2 * _GRID
        margin = reach + robot.track_radius
        line = profile.extended(margin + abs(x - profile.start), margin + abs(x - profile.end))
        count = math.ceil(2 * reach / _GRID) + 1
        places = x - reach + _GRID * np.arange(count, dtype=np.float64)
        above = inflated(line, x - reach, _GRID, count, robot.track_radius)
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
        needed = np.interp(self.x + ahead, self.places, self.above) - up
        at = needed.argmax(axis=1)[:, None]
        heights = np.take_along_axis(needed, at, axis=1)[:, 0]
        touching = self.x + np.take_along_axis(ahead, at, axis=1)[:, 0]
        contacts = np.interp(touching, self.places, self.contacts)
        arm = robot.flipper_mass * robot.flipper_axle / 2 / robot.mass
        masses = heights + arm * (np.sin(front) + np.sin(rear))
        levers = contacts - self.x - arm * (np.cos(front) - np.cos(rear))
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
