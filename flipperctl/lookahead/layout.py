"""The arrays of the prediction model: a state, the model's numbers, and how code is compiled.

The state of a robot is 10 numbers: x, z [m] of the centre of mass, pitch [rad], their rates, the
angles of the front and the rear flippers in frame R [rad], and their targets.
"""

from __future__ import annotations

from functools import partial

from numba import njit

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
