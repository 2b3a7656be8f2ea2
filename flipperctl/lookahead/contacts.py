"""Contacts of the prediction model's robot with the ground as machine code.

In: a capsule and the ground, or contacts and a motion. Out: contacts, or the motion after them.
"""

from __future__ import annotations

import math

from flipperctl.api import FloatArray
from flipperctl.lookahead.layout import FAST, FORCE, FRICTION, ITERATIONS, SPEED, STEP
from flipperctl.sim.jit import cached

MOST = 24
"""Largest number of simultaneous contacts with ground that was perceived, which is smoothed; those
of the chassis come first."""
MOST_EXACT = 240
"""The same with ground that is known as it is: recorded ground has a point each 1 or 2 cm."""
MARGIN = 0.02
"""Gap below which a contact is solved [m]."""
_SLOP = 0.0005
"""Overlap that is not corrected [m]."""
_PUSH = 0.3
"""Largest speed at which an overlap is corrected [m/s]."""


@cached(FAST)
def _add(
    contacts: FloatArray,
    count: int,
    x: float,
    z: float,
    nx: float,
    nz: float,
    gap: float,
    part: int,
) -> int:
    if count < len(contacts):
        row = contacts[count]
        row[0], row[1], row[2], row[3], row[4], row[5] = x, z, nx, nz, gap, part
        return count + 1
    return count


@cached(FAST)
def touches(
    ground: FloatArray,
    ax: float,
    az: float,
    bx: float,
    bz: float,
    radius: float,
    reach: float,
    part: int,
    contacts: FloatArray,
    count: int,
) -> int:
    """Append the contacts of a capsule with its axis from a to b; return their new number.

    ``ground``: (V, 5): x, z [m] of a point, and normal and length of the edge that begins there.
    A row of ``contacts`` is x, z [m] on the ground, the normal from ground to robot, the gap [m],
    and the part.
    """
    low, high = min(ax, bx) - reach, max(ax, bx) + reach
    first, last = 0, len(ground)
    while first < last:  # first point at or past the lower end
        middle = (first + last) // 2
        if ground[middle, 0] < low:
            first = middle + 1
        else:
            last = middle
    ux, uz = bx - ax, bz - az
    along = ux * ux + uz * uz
    farthest = reach * reach
    for i in range(max(0, first - 1), len(ground)):
        x, z = ground[i, 0], ground[i, 1]
        if i >= first and x <= high:  # a point of the ground against the axis
            px, pz = x - ax, z - az
            off = px * uz - pz * ux  # times the axis' length
            if off * off < farthest * along:
                share = min(1.0, max(0.0, (px * ux + pz * uz) / along))
                dx, dz = share * ux - px, share * uz - pz
                square = dx * dx + dz * dz
                if 1e-18 < square < farthest:
                    distance = math.sqrt(square)
                    count = _add(
                        contacts, count, x, z, dx / distance, dz / distance, distance - radius, part
                    )
        if i + 1 < len(ground):  # both ends of the axis against the edge
            nx, nz, length = ground[i, 2], ground[i, 3], ground[i, 4]
            for end in range(2):
                px, pz = (ax, az) if end == 0 else (bx, bz)
                height = (px - x) * nx + (pz - z) * nz
                if 0.0 <= height < reach:
                    share = (px - x) * nz - (pz - z) * nx
                    if 0.0 < share < length:
                        count = _add(
                            contacts,
                            count,
                            px - height * nx,
                            pz - height * nz,
                            nx,
                            nz,
                            height - radius,
                            part,
                        )
        if x > high:
            break
    return count


@cached(FAST)
def solve(
    contacts: FloatArray,
    count: int,
    motion: FloatArray,
    centre_x: float,
    centre_z: float,
    mass: float,
    inertia: float,
    extra: FloatArray,
    k: FloatArray,
    rows: FloatArray,
) -> None:
    """Solve all contacts by sequential impulses, which change the motion (vx, vz, turn) in place.

    ``extra`` (3, 5): additional motion of each part as the flippers turn: velocity x, z of its
    hinge, turn rate, and position x, z of the hinge. ``rows`` is working memory, (C, 10), of as
    many rows as ``contacts``.
    """
    dt, light, slow = k[STEP], 1 / mass, 1 / inertia
    for c in range(count):
        contact, row = contacts[c], rows[c]
        rx, rz = contact[0] - centre_x, contact[1] - centre_z
        nx, nz, gap = contact[2], contact[3], contact[4]
        part = extra[int(contact[5])]
        ox = part[0] - part[2] * (contact[1] - part[4])
        oz = part[1] + part[2] * (contact[0] - part[3])
        arm, across = rx * nz - rz * nx, -rx * nx - rz * nz
        # Normal: in this step, approach by no more than the gap.
        bias = gap / dt if gap > 0 else -min(_PUSH, 0.2 / dt * max(0.0, -gap - _SLOP))
        row[0], row[1], row[2], row[3] = nx, nz, arm, across
        row[4] = ox * nx + oz * nz + bias
        # Friction: the belt pulls the robot along the tangent (nz, -nx) at its speed.
        row[5] = ox * nz - oz * nx - k[SPEED]
        row[6] = 1 / (light + arm * arm * slow)
        row[7] = 1 / (light + across * across * slow)
        row[8] = row[9] = 0.0
    vx, vz, turn = motion[0], motion[1], motion[2]
    strongest, pressed = k[FORCE] * dt, 0.0  # of all belts; normal impulses so far
    for _ in range(int(k[ITERATIONS])):
        friction = k[FRICTION]
        if friction * pressed > strongest:  # the motors stall before the belts slip
            friction = strongest / pressed
        for c in range(count):
            row = rows[c]
            nx, nz, arm, across = row[0], row[1], row[2], row[3]
            whole = max(0.0, row[8] - (vx * nx + vz * nz + turn * arm + row[4]) * row[6])
            impulse, row[8] = whole - row[8], whole
            pressed += impulse
            vx += impulse * nx * light
            vz += impulse * nz * light
            turn += impulse * arm * slow
            most = friction * whole
            whole = row[9] - (vx * nz - vz * nx + turn * across + row[5]) * row[7]
            whole = min(most, max(-most, whole))
            impulse, row[9] = whole - row[9], whole
            vx += impulse * nz * light
            vz -= impulse * nx * light
            turn += impulse * across * slow
    motion[0], motion[1], motion[2] = vx, vz, turn
