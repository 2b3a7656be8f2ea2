"""The privileged state: what a simulation knows of an episode and a robot does not perceive.

In: an environment and the transitions of its episode. Out: numbers of about unit size, for a
learner that estimates values from them (``agent.privileged_value``). No policy sees them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import RobotState, Transition
from flipperctl.env.flipper_env import FlipperEnv

_AHEAD: Final = np.arange(0.0, 6.4, 0.2)
"""Distances from the chassis centre at which the true ground is read, forward [m]."""
_HEIGHT, _DISTANCE, _PROGRESS, _FRICTION, _SPEED = 0.5, 5.0, 0.5, 0.5, 0.2
"""Sizes that the numbers are divided by, in SI units."""
SIZE: Final = len(_AHEAD) + 13
"""Length of a privileged state, P."""


class PrivilegedStates:
    """The privileged states of one episode, collected while it is played."""

    def __init__(self, env: FlipperEnv) -> None:
        """Collect the states of the next episode of ``env``."""
        self._env = env
        self._states: list[RobotState] = []
        self.rows: list[NDArray[np.float32]] = []
        """Privileged states at the start and after each decision so far, each (P,)."""

    def add(self, t: Transition) -> None:
        """Add the state after a decision; before the first one, that at the start too."""
        for state in (t.after,) if self._states else (t.before, t.after):
            self._states.append(state)
            self.rows.append(_privileged_state(self._env, self._states))


def _privileged_state(env: FlipperEnv, states: Sequence[RobotState]) -> NDArray[np.float32]:
    """Return the privileged state at the newest of ``states``, (P,) [-].

    - heights of the ground every 0.2 m up to 6.2 m ahead, above the chassis centre
    - pitch, pitch rate, roll and velocity
    - distance to the finish, and share of the time limit that is left
    - progress within the window that decides about being stuck, and share of it that has passed
    - speed and sizes of the robot, and friction
    """
    state, profile, robot = states[-1], env.profile, env.robot
    x, z = state.position
    # Past the last point np.interp returns its height, as the level ground there has.
    ground = np.interp(x + _AHEAD, *profile.points.T) - z
    limit = env.drive.termination
    window = env.config.episode.stuck_decisions(env.config.robot.decision_period)
    recent = states[-window - 1 :]
    friction = env.engine.shared_setting("friction")
    numbers = (
        state.pitch,
        state.pitch_rate,
        state.roll,
        *(state.velocity / _SPEED),
        (limit.finish - x) / _DISTANCE,
        1 - (len(states) - 1) / limit.t_max,
        (x - recent[0].position[0]) / _PROGRESS,
        (len(recent) - 1) / window,
        robot.track_speed / _SPEED,
        robot.chassis_length,
        robot.flipper_length,
        0.0 if friction is None else friction / _FRICTION,
    )
    row = np.empty(SIZE, np.float32)
    row[: len(ground)], row[len(ground) :] = ground / _HEIGHT, numbers
    return row
