"""The ground in 3-D: a profile extruded sideways, or strips of a surface, as boxes.

In: a profile, the engine's settings and a generator. Out: boxes that fill the ground below the
profile or its surface, as deep as tracks feel it. MuJoCo's boxes give every capsule on them two
contacts in a line. On convex meshes, tracks stalled at ridges between facets. MuJoCo's height
fields took 3 to 18 times as long and agreed less with the planar engine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from flipperctl.api import FloatArray, Profile, Surface
from flipperctl.errors import PluginFailedError, TerrainError
from flipperctl.sim.mujoco.settings import MujocoSettings

GROUND_WIDTH = 4.0
"""Width of the ground, half to each side [m]."""
CLOSE = 1e-6
"""Borders closer than this are one, since sums of widths are rounded [m]."""
LEVEL_GROUND = 20.0
"""Length of the level ground before and past the profile [m]."""
_RAMP = 0.2
"""Length in which level ground beside the line rises to the surface's first heights [m].

The robot's front flippers end 0.28 m before the first edge when it starts.
"""
_TOLERANCE = 1e-3
"""Largest distance by which straight parts may differ from the recorded ground [m].

Contacts are so soft that tracks sink in by about as much, and half as many boxes are left.
"""
_MARGIN = 0.15  # narrow strips beside the robot [m]
_WIDE = 0.5  # largest width of the strips farther away [m]


class Strip(NamedTuple):
    """A part of the ground along x that is constant over its width."""

    low: float  # its right border's y [m]
    high: float  # its left border's y [m]
    line: FloatArray  # its outline, level ground before and past it included, (V, 2) of x and z [m]


def surface_strips(
    profile: Profile,
    surface: Surface,
    borders: list[float],
    fixed: list[float],
    within: float,
) -> list[Strip]:
    """Return the strips between ascending borders.

    Equal neighbours become one strip. The ``fixed`` borders remain. ``within``: largest distance of
    the robot's tracks from the line at the start [m].

    Raises:
        TerrainError: the surface has no heights there, or unknown ones where the robot drives.
        PluginFailedError: the surface returns heights of another shape.
    """
    # A strip has the heights of its middle.
    y = np.array([(low + high) / 2 for low, high in pairwise(borders)])
    try:
        heights = surface.heights(y)
    except ValueError as error:
        raise TerrainError(f"sim=mujoco: {error}") from error
    if heights.shape != (allowed := (len(surface.x), len(y))):
        raise PluginFailedError(
            f"{type(surface).__name__}.heights returned an array of the shape {heights.shape}; "
            f"{allowed} is allowed"
        )
    # Unknown ground is allowed only where no track can be.
    driven = np.array([max(low, -high, 0.0) < within for low, high in pairwise(borders)])
    if len(unknown := np.argwhere(~np.isfinite(heights) & driven)):
        i, j = unknown[0]
        raise TerrainError(
            f"sim=mujoco: the ground is unknown {surface.x[i]:.2f} m along the line and "
            f"{abs(y[j]):.2f} m to its {'left' if y[j] > 0 else 'right'}, in a hole or outside the "
            f"recording; the robot needs {within:.2f} m to each side: move the line, or raise the "
            "terrain's largest_gap"
        )
    heights = _continued(heights, y)
    # Fewer strips are fewer boxes, so that equal neighbours become one.
    strips: list[Strip] = []
    for (low, high), column in zip(pairwise(borders), heights.T, strict=True):
        line = _outline(profile, surface.x, column)
        free = all(abs(low - border) > CLOSE for border in fixed)
        if strips and free and np.array_equal(strips[-1].line, line):
            low, line = strips.pop().low, line
        strips.append(Strip(low, high, line))
    return strips


def _continued(heights: FloatArray, y: FloatArray) -> FloatArray:
    """Return the heights (X, Y); the next strip towards the line supplies unknown ones."""
    known = heights.copy()
    # From the line outwards, so that the inner neighbour is known already.
    for j in np.argsort(np.abs(y), kind="stable"):
        inward = j - 1 if y[j] > 0 else j + 1
        if 0 <= inward < len(y):
            known[:, j] = np.where(np.isfinite(known[:, j]), known[:, j], known[:, inward])
    return known


def _outline(profile: Profile, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return a strip's outline: level as the line before and past it, without straight points."""
    from flipperctl.sim.ground import kept_points  # numba takes a third of a second to import

    points = np.column_stack([x, z])
    keep = kept_points(points, np.zeros(len(points), dtype=np.bool_), _TOLERANCE, 0.0)
    first, last = profile.points[0], profile.points[-1]
    return np.vstack(
        [
            [first[0] - LEVEL_GROUND, first[1]],
            [first[0] - _RAMP, first[1]],
            points[keep],
            [last[0] + _RAMP, last[1]],
            [last[0] + LEVEL_GROUND, last[1]],
        ]
    )


MOST = 20_000
"""Largest number of boxes, with which a reset takes about 1 s."""

_SIMPLER = "cut it, sample it more coarsely or lower sim.roughness to 0"
_SMALLER = "shorten the line, or raise sim.strip_width or the terrain's spacing"
_BELOW = 0.3  # ground below the lowest point [m]
_THICK, _THIN = 0.1, 0.01
"""Largest and smallest thickness of the board below a slope [m].

At ridges sharper than 90° the thinnest board still sticks out on the other side, by less than its
thickness.
"""
_COLUMN, _RISE = 0.5, 0.1  # largest length and difference in height of boards on one column [m]
_SUNK = 0.02  # depth of a column below the lowest of its boards, so that no track touches it [m]
_PATCH = 0.25  # length of a patch of rough ground [m]
_STRIP = 0.2  # width of a patch of rough ground [m]
_ROUGH_HALF = 1.0  # rough ground to each side of the middle [m]
_INCLINE = 1.0  # shortest incline that replaces a step up or down on the right [m]
_PIECES = 1.0, 0.1
"""Largest length of a box that lies obliquely: on one strip, and where strips differ [m]."""
ROUGH_MARGIN = 0.2
"""Rough ground before the first and past the last edge [m]."""


class Box(NamedTuple):
    """A box in world whose upper face is ground."""

    centre: tuple[float, float, float]  # x, y, z [m]
    half: tuple[float, float, float]  # half its length, width and thickness [m]
    tilt: float  # slope of its upper face, up towards +x positive [rad]
    turn: float = 0.0  # about the z axis, to the left positive [rad]


class Ground(NamedTuple):
    """The ground of one episode."""

    strips: list[Strip]  # from right to left, as they are driven over
    boxes: list[Box]


def lay(profile: Profile, sim: MujocoSettings, rng: np.random.Generator) -> Ground:
    """Return the ground; the roughness is sampled from ``rng``."""
    strips = _strips(profile, sim)
    # All boxes reach down to one base, below the lowest point of the rough ground.
    base = min(float(strip.line[:, 1].min()) for strip in strips) - _BELOW - sim.roughness
    boxes, driven = list[Box](), list[Strip]()
    for low, high, line in strips:
        # The settings change a strip before it becomes boxes: its height first, then its roughness.
        strip = _farther(_lowered(line, sim.one_sided), sim.stagger) if high <= 0 else line
        if sim.roughness and max(-low, high) <= _ROUGH_HALF:
            ends = profile.start - ROUGH_MARGIN, profile.end + ROUGH_MARGIN
            strip = _roughened(strip, ends, sim.roughness, rng)
        driven.append(Strip(low, high, strip))
        if sim.oblique:
            (low, high), strip = _widened(low, high), strip * (math.cos(sim.oblique), 1.0)
        boxes += _extruded(strip, low, high, base)
        # The boards of a surface leave gaps at their sides where the next strip is lower.
        if profile.surface is not None and len(strips) > 1:
            boxes += _columns(_without_repeats(strip), low, high, base)
        if len(boxes) > MOST:
            raise TerrainError(
                f"sim=mujoco: the ground below {len(profile.points)} points needs more than "
                f"{MOST} boxes; {_SMALLER if profile.surface else _SIMPLER}"
            )
    if sim.oblique:
        boxes = [*_oblique(boxes, sim.oblique, _cells(profile, sim, len(strips) > 1))]
    if sim.mirrored:
        boxes = [Box((x, -y, z), half, tilt, -turn) for (x, y, z), half, tilt, turn in boxes]
        driven = [Strip(-high, -low, line) for low, high, line in reversed(driven)]
    return Ground(driven, boxes)


def _strips(profile: Profile, sim: MujocoSettings) -> list[Strip]:
    """Return the strips along x that divide the ground, from right to left."""
    half = GROUND_WIDTH / 2
    # Borders at which the settings change the ground; no joining of strips may remove them
    changed: set[float] = set()  # borders at which these settings change the ground
    if sim.one_sided or sim.stagger:
        changed.add(0.0)
    if sim.roughness:
        count = round(2 * _ROUGH_HALF / _STRIP)
        changed |= {float(y) for y in np.linspace(-_ROUGH_HALF, _ROUGH_HALF, count + 1)}
    # A profile has one outline, so that no other border is needed.
    if profile.surface is None:
        line = profile.extended(LEVEL_GROUND, LEVEL_GROUND)
        return [Strip(*ends, line) for ends in pairwise(_within({-half, half} | changed, half))]
    # A surface has narrow strips where the tracks drive, and wide ones farther away.
    reach, width = sim.flipper_offset + sim.track_width / 2 + sim.offset, sim.strip_width
    count = math.ceil((reach + _MARGIN) / width)  # narrow strips on each side
    wide = np.arange(count * width, half, _WIDE).tolist()
    positive = {*(width * k for k in range(count)), *wide}
    borders = _within({-half, half, *positive, *(-y for y in positive)} | changed, half)
    return surface_strips(profile, profile.surface, borders, _within(changed, half), reach)


def _within(borders: set[float], half: float) -> list[float]:
    edges: list[float] = []
    for y in sorted(y for y in borders if abs(y) <= half):
        if not edges or y - edges[-1] > CLOSE:
            edges.append(y)
    return edges


def _lowered(line: FloatArray, fraction: float) -> FloatArray:
    """Return the polyline with the obstacle lowered to the line between its ends.

    That line is at least ``_INCLINE`` long, so that a single step has one too.
    """
    (x0, z0), (x1, z1) = line[1], line[-2]
    if x1 < x0 + _INCLINE and z0 != z1:
        x1 = x0 + _INCLINE
        line = np.insert(line, -1, (x1, z1), axis=0)
    x, z = line.T
    between = np.interp(x, (x0, x1), (z0, z1)) if z0 != z1 else z0
    return np.column_stack([x, z + fraction * (between - z)])


def _farther(line: FloatArray, distance: float) -> FloatArray:
    """Return the polyline with the obstacle moved ahead between its ends, which stay [m]."""
    moved = line.copy()
    moved[1:-1, 0] += distance
    return moved


def _widened(low: float, high: float) -> tuple[float, float]:
    """Return a strip's borders, those of the ground farther out, as turned boxes need them [m]."""
    half, more = GROUND_WIDTH / 2, 2 * _PIECES[0]
    return low - more * (low == -half), high + more * (high == half)


def _oblique(boxes: Sequence[Box], angle: float, cells: FloatArray) -> Iterator[Box]:
    """Yield boxes whose edges lie at ``angle`` across the way, from boxes that lie straight.

    Their x are shortened by the angle's cosine, so that the outline along the way stays. ``cells``:
    ascending x (C,) at which boxes are cut [m]; within a cell, borders of strips lie as its edges.
    """
    sin, cos = math.sin(angle), math.cos(angle)
    for (x, y, z), (length, width, thick), tilt, _ in boxes:
        flat, rise = math.cos(tilt), math.sin(tilt)
        inner = cells[np.abs(cells - x) < length * flat - CLOSE]
        ends = [-length, *((inner - x) / flat).tolist(), length]
        for low, high in pairwise(ends):
            # The piece's middle along the edges' normal, and the middle of its cell
            at = x + (low + high) / 2 * flat
            cell = int(np.searchsorted(cells, at))
            moved = (float(cells[cell - 1 : cell + 1].mean()) - at) * sin
            place = at / cos + (y + moved) * sin / cos, y + moved, z + (low + high) / 2 * rise
            yield Box(place, ((high - low) / 2, width / cos, thick), tilt, -angle)


def _cells(profile: Profile, sim: MujocoSettings, fine: bool) -> FloatArray:
    """Return where ``_oblique`` cuts, (C,) [m]: finely where strips differ."""
    cos, margin = math.cos(sim.oblique), sim.stagger + _INCLINE
    low, high = (math.floor(cos * (x + d)) for x, d in ((profile.start, -1), (profile.end, 1)))
    far = np.arange(low - LEVEL_GROUND - 1, high + LEVEL_GROUND + 3, _PIECES[0])
    near = np.arange(low, high + 1 + math.ceil(margin), _PIECES[1])
    return np.unique(np.concatenate([far, near]).round(6)) if fine else far


def _roughened(
    line: FloatArray, ends: tuple[float, float], height: float, rng: np.random.Generator
) -> FloatArray:
    """Return the polyline with each patch between the ends shifted by up to ± ``height`` [m]."""
    first = ends[0] + rng.uniform(0.0, _PATCH)  # no border lies at a face
    borders = [ends[0], *np.arange(first, ends[1], _PATCH), ends[1]]
    parts = [_cut(line, -math.inf, ends[0])]
    for low, high in pairwise(borders):
        part = _cut(line, low, high)
        part[:, 1] += rng.uniform(-height, height)
        parts.append(part)
    return np.concatenate([*parts, _cut(line, ends[1], math.inf)])


def _cut(line: FloatArray, low: float, high: float) -> FloatArray:
    """Return the part of the polyline with x between ``low`` and ``high``."""
    inside = line[(line[:, 0] > low) & (line[:, 0] < high)]
    ends = [[x, float(np.interp(x, *line.T))] for x in (low, high) if math.isfinite(x)]
    before = ends[:1] if math.isfinite(low) else []
    after = ends[-1:] if math.isfinite(high) else []
    return np.array([*before, *inside.tolist(), *after])


def _extruded(line: FloatArray, low: float, high: float, base: float) -> Iterator[Box]:
    """Yield the boxes of a strip between y ``low`` and ``high`` [m], down to ``base`` [m]."""
    line = _without_repeats(line)
    steps = np.diff(line, axis=0)
    level = steps[:, 1] == 0
    middle, half = (low + high) / 2, (high - low) / 2
    for i, ((x0, z0), (x1, z1)) in enumerate(pairwise(line.tolist())):
        if level[i]:
            # Level ground is a block down to the base.
            depth = (z0 - base) / 2
            yield Box(((x0 + x1) / 2, middle, z0 - depth), ((x1 - x0) / 2, half, depth), 0.0)
            continue
        if x1 == x0 and level[i + 1 if z1 > z0 else i - 1]:
            continue  # the side of the column at the top is this face
        # A slope is a board, so that its upper face is the ground.
        tilt, length = math.atan2(z1 - z0, x1 - x0), math.hypot(x1 - x0, z1 - z0)
        thick = _thickness(line, i) / 2
        x = (x0 + x1) / 2 + thick * math.sin(tilt)
        z = (z0 + z1) / 2 - thick * math.cos(tilt)
        yield Box((x, middle, z), (length / 2, half, thick), tilt)


def _columns(line: FloatArray, low: float, high: float, base: float) -> Iterator[Box]:
    """Yield boxes below the boards of a strip, which close its sides towards lower strips."""
    begin = 0
    for end in range(1, len(line)):
        # Boards share a column until it would be too long or its boards too uneven.
        following = line[begin : end + 2]
        if end + 1 < len(line) and (np.ptp(following, axis=0) <= (_COLUMN, _RISE)).all():
            continue
        (x0, z0), (x1, z1) = line[begin], line[end]
        level = end == begin + 1 and z0 == z1  # which has a box down to the base
        top = float(line[begin : end + 1, 1].min()) - _SUNK
        if x1 > x0 and not level:
            half = (x1 - x0) / 2, (high - low) / 2, (top - base) / 2
            yield Box((x0 + half[0], (low + high) / 2, base + half[2]), half, 0.0)
        begin = end


def _without_repeats(line: FloatArray) -> FloatArray:
    """Return the polyline without repeated points and without points on level ground."""
    line = line[np.concatenate([[True], (np.diff(line, axis=0) != 0).any(axis=1)])]
    z = line[:, 1]
    flat = np.concatenate([[False], (z[1:-1] == z[:-2]) & (z[1:-1] == z[2:]), [False]])
    bends: FloatArray = line[~flat]
    return bends


def _thickness(line: FloatArray, index: int) -> float:
    """Return the largest thickness of a board below segment ``index`` within the ground [m]."""
    a, b = line[index], line[index + 1]
    x = line[:, 0]
    # Only ground within the largest thickness can limit the board.
    first = int(np.searchsorted(x, a[0] - _THICK, side="left"))
    last = int(np.searchsorted(x, b[0] + _THICK, side="right"))
    near = line[max(0, first - 1) : last + 1] - a
    length = math.dist(a, b)
    ahead = (b - a) / length
    s, depth = near @ ahead, near @ np.array([ahead[1], -ahead[0]])  # along and inward [m]
    thickness = _THICK
    # The board ends where its lower face would leave the ground on the other side.
    for (s0, d0), (s1, d1) in pairwise(np.column_stack([s, depth]).tolist()):
        low, high = max(0.0, min(s0, s1)), min(length, max(s0, s1))
        if high - low < 1e-9 or max(d0, d1) < 1e-9:
            continue  # beside the board, or above the ground's surface
        ends = [d0 + (d1 - d0) * (at - s0) / (s1 - s0) for at in (low, high)]
        thickness = min(thickness, *ends)
    return max(_THIN, thickness)
