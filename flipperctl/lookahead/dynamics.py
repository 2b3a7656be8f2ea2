"""The dynamics of the prediction model as machine code: a rigid robot with ideal servos.

The flippers follow their targets at their full rate under any load. The robot is thus one rigid
body of changing shape: three degrees of freedom instead of nine, and no joints to solve. Contacts
are modelled as in the engine: rounded ends and edges, friction, and belts along the outline. A
decision takes about a tenth of the engine's time.

The state of a robot is 10 numbers. They are x and z [m] of the centre of mass, pitch [rad] and
their rates. The angles of the front and the rear flippers in frame R [rad] follow, and their
targets.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flipperctl.api import FloatArray
from flipperctl.api.jit import cached

STATE = 10
"""Length of a state."""

# Indices into the array of the model's numbers, see ``Model``.
HINGE, AXLE, RADIUS, CHASSIS, FLIPPER, TURN_CHASSIS, TURN_FLIPPER, SPEED, RATE = range(9)
GRAVITY, FRICTION, STEP, ITERATIONS, OVERTURN, FINISH, TOP, SAMPLE = range(9, 17)
LOAD_X, LOAD_Z, FORCE, CONTACTS = range(17, 21)
NUMBERS = 21

RUNNING, OVERTURNED, REACHED = range(3)
"""How a predicted decision ends."""

FAST = partial(
    njit, error_model="numpy", fastmath={"reassoc", "contract", "arcp", "nsz"}
)  # allows reordered sums: a fifth faster, still equal in every run on one machine


MOST = 24
"""Largest number of simultaneous contacts with ground that was perceived, which is smoothed; the
chassis' contacts come first."""
MOST_EXACT = 240
"""The same with ground that is known as it is: recorded ground has a point each 1 or 2 cm."""
MARGIN = 0.02
"""Gap below which a contact is solved [m]."""
_SLOP = 0.0005  # overlap that is not corrected [m]
_PUSH = 0.3  # largest speed at which an overlap is corrected [m/s]


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
    # One edge earlier, since an edge that begins before the lower end may reach past it.
    for i in range(max(0, first - 1), len(ground)):
        x, z = ground[i, 0], ground[i, 1]
        if i >= first and x <= high:  # a point of the ground against the axis
            px, pz = x - ax, z - az
            off = px * uz - pz * ux  # times the axis' length
            # Squares spare a root for the many points that are out of reach.
            if off * off < farthest * along:
                share = min(1.0, max(0.0, (px * ux + pz * uz) / along))
                dx, dz = share * ux - px, share * uz - pz
                square = dx * dx + dz * dz
                # A point on the axis itself has no direction in which it pushes.
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
    # What stays the same in all iterations: directions, lever arms, the flippers' own motion, and
    # the mass that an impulse meets
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
    # Sequential impulses: each contact corrects what the others have left.
    for _ in range(int(k[ITERATIONS])):
        friction = k[FRICTION]
        if friction * pressed > strongest:  # the motors stall before the belts slip
            friction = strongest / pressed
        for c in range(count):
            row = rows[c]
            nx, nz, arm, across = row[0], row[1], row[2], row[3]
            # Along the normal, contacts only push.
            whole = max(0.0, row[8] - (vx * nx + vz * nz + turn * arm + row[4]) * row[6])
            impulse, row[8] = whole - row[8], whole
            pressed += impulse
            vx += impulse * nx * light
            vz += impulse * nz * light
            turn += impulse * arm * slow
            # Along the tangent, the normal impulse limits friction.
            most = friction * whole
            whole = row[9] - (vx * nz - vz * nx + turn * across + row[5]) * row[7]
            whole = min(most, max(-most, whole))
            impulse, row[9] = whole - row[9], whole
            vx += impulse * nz * light
            vz -= impulse * nx * light
            turn += impulse * across * slow
    motion[0], motion[1], motion[2] = vx, vz, turn


@cached(FAST)
def mass_centre(front: float, rear: float, k: FloatArray) -> tuple[float, float, float]:
    """Return the centre of mass in the chassis' frame, x and z [m], and the inertia [kg m²]."""
    fx, fz = k[HINGE] + 0.5 * k[AXLE] * math.cos(front), 0.5 * k[AXLE] * math.sin(front)
    bx, bz = -k[HINGE] - 0.5 * k[AXLE] * math.cos(rear), 0.5 * k[AXLE] * math.sin(rear)
    mass = k[CHASSIS] + 2 * k[FLIPPER]
    x = (k[CHASSIS] * k[LOAD_X] + k[FLIPPER] * (fx + bx)) / mass
    z = (k[CHASSIS] * k[LOAD_Z] + k[FLIPPER] * (fz + bz)) / mass
    # Parallel axes: each part's own inertia, and its distance from the common centre
    inertia = k[TURN_CHASSIS] + 2 * k[TURN_FLIPPER]
    inertia += k[CHASSIS] * ((k[LOAD_X] - x) ** 2 + (k[LOAD_Z] - z) ** 2)
    inertia += k[FLIPPER] * ((fx - x) ** 2 + (fz - z) ** 2 + (bx - x) ** 2 + (bz - z) ** 2)
    return x, z, inertia


@cached(FAST)
def chassis(state: FloatArray, k: FloatArray) -> tuple[float, float]:
    """Return x and z of the chassis centre [m]."""
    gx, gz, _ = mass_centre(state[6], state[7], k)
    cos, sin = math.cos(state[2]), math.sin(state[2])
    return state[0] - (cos * gx - sin * gz), state[1] - (sin * gx + cos * gz)


@cached(FAST)
def _pose(state: FloatArray, k: FloatArray, pose: FloatArray) -> None:
    """Write x, z [m] of the chassis centre, pitch and flipper angles [rad] into ``pose``, (5,)."""
    pose[0], pose[1] = chassis(state, k)
    pose[2], pose[3], pose[4] = state[2], state[6], state[7]


@cached(FAST)
def advance(
    state: FloatArray,
    steps: int,
    ground: FloatArray,
    k: FloatArray,
    contacts: FloatArray,
    rows: FloatArray,
    extra: FloatArray,
    motion: FloatArray,
    pair: FloatArray,
    poses: FloatArray,
) -> tuple[float, float, int]:
    """Simulate ``steps`` steps in place.

    Return the pitch variation and the largest |pitch| [rad], and how the decision ended.
    ``poses`` (S + 1, 5) receives the poses of the chassis centre and the flippers' angles every
    ``SAMPLE`` seconds, interpolated between steps; without rows, none are computed. After an
    outcome the last pose is repeated. ``contacts``, ``rows``, ``extra``, ``motion`` and ``pair``
    are working memory. It is one function, since its parts would pass a dozen numbers to each
    other.
    """
    samples, sampled, outcome = len(poses), 1, RUNNING
    former, last = pair[0], pair[1]
    if samples:
        _pose(state, k, former)
        poses[0] = former
    dt, mass = k[STEP], k[CHASSIS] + 2 * k[FLIPPER]
    radius, reach, most = k[RADIUS], k[RADIUS] + MARGIN, k[RATE] * k[STEP]
    variation, steep = 0.0, 0.0
    gx, gz, inertia = mass_centre(state[6], state[7], k)
    cos_f, sin_f = k[AXLE] * math.cos(state[6]), k[AXLE] * math.sin(state[6])
    cos_r, sin_r = k[AXLE] * math.cos(state[7]), k[AXLE] * math.sin(state[7])
    for index in range(steps):
        # The flippers turn towards their targets at their full rate, whatever they meet.
        was_x, was_z = gx, gz
        front_turn = min(most, max(-most, state[8] - state[6]))
        rear_turn = min(most, max(-most, state[9] - state[7]))
        if front_turn != 0.0 or rear_turn != 0.0:
            state[6] += front_turn
            state[7] += rear_turn
            gx, gz, inertia = mass_centre(state[6], state[7], k)
            cos_f, sin_f = k[AXLE] * math.cos(state[6]), k[AXLE] * math.sin(state[6])
            cos_r, sin_r = k[AXLE] * math.cos(state[7]), k[AXLE] * math.sin(state[7])
        # Turning flippers move the centre of mass, so that the chassis shifts against it.
        cos, sin = math.cos(state[2]), math.sin(state[2])
        sx, sz = -(gx - was_x) / dt, -(gz - was_z) / dt  # the chassis' shift against the centre
        shift_x, shift_z = cos * sx - sin * sz, sin * sx + cos * sz
        # The chassis centre, the hinges and the tips.
        x, z = state[0] - (cos * gx - sin * gz), state[1] - (sin * gx + cos * gz)
        hx, hz = cos * k[HINGE], sin * k[HINGE]
        fx, fz, rx, rz = x + hx, z + hz, x - hx, z - hz
        tip_fx, tip_fz = fx + cos * cos_f - sin * sin_f, fz + sin * cos_f + cos * sin_f
        tip_rx, tip_rz = rx - cos * cos_r - sin * sin_r, rz - sin * cos_r + cos * sin_r
        # Contacts of the chassis come first, as the number of contacts is limited.
        count = touches(ground, rx, rz, fx, fz, radius, reach, 0, contacts, 0)
        count = touches(ground, fx, fz, tip_fx, tip_fz, radius, reach, 1, contacts, count)
        count = touches(ground, rx, rz, tip_rx, tip_rz, radius, reach, 2, contacts, count)
        # Gravity, then the impulses of the contacts
        motion[0], motion[1], motion[2] = state[3], state[4] - k[GRAVITY] * dt, state[5]
        if count:
            extra[:, 0], extra[:, 1] = shift_x, shift_z
            extra[0, 2], extra[1, 2], extra[2, 2] = 0.0, front_turn / dt, -rear_turn / dt
            extra[1, 3], extra[1, 4], extra[2, 3], extra[2, 4] = fx, fz, rx, rz
            solve(contacts, count, motion, state[0], state[1], mass, inertia, extra, k, rows)
        # Semi-implicit Euler: the new velocity moves the robot.
        state[3], state[4], state[5] = motion[0], motion[1], motion[2]
        state[0] += motion[0] * dt
        state[1] += motion[1] * dt
        state[2] += motion[2] * dt
        variation += abs(motion[2] * dt)
        steep = max(steep, abs(state[2]))
        # Poses every sample lie between two steps; the finish counts with both ends low enough.
        if samples:
            _pose(state, k, last)
            time = (index + 1) * dt
            while sampled < samples and sampled * k[SAMPLE] <= time + 1e-9:
                share = (time - sampled * k[SAMPLE]) / dt
                for column in range(5):
                    poses[sampled, column] = last[column] + share * (former[column] - last[column])
                sampled += 1
            former[:] = last
            higher = last[1] + k[HINGE] * abs(math.sin(last[2]))
            if last[0] >= k[FINISH] and higher <= k[TOP]:
                outcome = REACHED
        if steep >= k[OVERTURN]:
            outcome = OVERTURNED
        if outcome != RUNNING:
            break
    # After an outcome the robot stays where it is.
    for row in range(sampled, samples):
        poses[row] = last
    return variation, steep, outcome


@cached(FAST)
def expand(
    states: FloatArray,
    targets: FloatArray,
    steps: int,
    ground: FloatArray,
    k: FloatArray,
    reached: FloatArray,
    place: FloatArray,
    variation: FloatArray,
    steep: FloatArray,
    outcome: NDArray[np.int64],
    poses: FloatArray,
) -> None:
    """Simulate one decision from each state, (M, ``STATE``), towards its targets, (M, 2).

    ``poses`` is (M, S + 1, 5), or (M, 0, 5) to compute none; see ``advance``.
    """
    most = int(k[CONTACTS])
    contacts, rows = np.empty((most, 6)), np.empty((most, 10))
    extra, motion, pair = np.zeros((3, 5)), np.empty(3), np.empty((2, 5))
    for row in range(len(states)):
        reached[row] = states[row]
        reached[row, 8], reached[row, 9] = targets[row, 0], targets[row, 1]
        variation[row], steep[row], outcome[row] = advance(
            reached[row], steps, ground, k, contacts, rows, extra, motion, pair, poses[row]
        )
        place[row, 0], place[row, 1] = chassis(reached[row], k)
