"""The belts of the tracks: how they steer, and the largest force of their motors.

In: MuJoCo's data and the settings of robot and engine. Out: surface velocities and friction of the
tracks' parts, written to the model.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flipperctl.api import SAMPLE_PERIOD, FloatArray, Robot
from flipperctl.sim.mujoco.model import Model
from flipperctl.sim.mujoco.settings import MujocoSettings

_SIDES = 1.0, -1.0
"""Left and right, as in ``Model.sides``."""
_LARGEST_STEER = 0.5
"""Largest difference of a belt's speed from the robot's by steering, as a fraction [-]."""
_STEER_AHEAD = 1.0
"""Steering aims at the middle of the ground this far ahead [m]."""
_AVERAGING = 0.1
"""Time over which normal forces are averaged for the motors' limit; contacts hop [s]."""


class Tracks:
    """The belts on both sides of one robot."""

    def __init__(self, built: Model, robot: Robot, sim: MujocoSettings) -> None:
        """Drive the belts of the ``built`` model."""
        self._model, self._belts, self._sides = built
        self._gain, self._speed, self._friction = sim.heading_gain, robot.track_speed, sim.friction
        self._force = robot.track_force
        if self._force is not None:  # a contact has the larger friction of its two shapes
            self._model.geom_friction[self._sides == 0, 0] = 0.0
        weight = robot.mass * sim.gravity
        self.pressed = 0.0, 0.0
        """Averaged normal forces on the left and on the right tracks [N]."""
        self.restore((weight / 2, weight / 2))

    def steer(self, yaw: float, side: float) -> None:
        """Set the belts' speeds for a heading [rad] and a distance beside the middle [m]."""
        if self._gain:
            faster = self._faster(yaw, side)
            self._model.geom_surfacevel[:] = self._belts * (1.0 + faster * self._sides)[:, None]

    def _faster(self, yaw: float, side: float) -> float:
        """Return by which fraction the left belts run faster than the robot's speed."""
        steer = self._gain * (yaw + side / _STEER_AHEAD)
        return min(_LARGEST_STEER, max(-_LARGEST_STEER, steer))

    def speeds(self, yaw: float, side: float) -> FloatArray:
        """Return the speeds of the left and the right belts, (2,) [m/s]."""
        faster = self._speed * self._faster(yaw, side)
        return np.array([self._speed + faster, self._speed - faster])

    def limit(self, data: Any) -> None:
        """Scale the friction of each side so that its motor can supply the force of its belts.

        It is called after each sample, for the next one. A belt that its load holds slips as one
        without grip; each side has half of ``robot.track_force``.
        """
        if self._force is None:
            return
        found = data.contact.efc_address >= 0
        normal = data.efc_force[data.contact.efc_address[found]]  # (C,) [N]
        sides = self._sides[data.contact.geom[found]].sum(axis=1)  # (C,), the ground has 0
        rate = SAMPLE_PERIOD / _AVERAGING
        left, right = (
            (1 - rate) * before + rate * float(normal[sides == side].sum())
            for side, before in zip(_SIDES, self.pressed, strict=True)
        )
        self.restore((left, right))

    def restore(self, pressed: tuple[float, float]) -> None:
        """Take the averaged normal forces [N], and set the friction that follows from them."""
        self.pressed = pressed
        if self._force is not None:
            for side, force in zip(_SIDES, pressed, strict=True):
                usable = min(self._friction, self._force / 2 / max(force, 1e-9))
                self._model.geom_friction[self._sides == side, 0] = usable
