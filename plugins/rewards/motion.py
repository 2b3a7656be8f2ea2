"""Reward terms of the robot's motion: progress, pitch variation, flippers and impact."""

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from flipperctl.api import (
    Profile,
    RewardTerm,
    RobotGeometry,
    RobotState,
    Shaping,
    Transition,
    limited,
    reward,
)
from flipperctl.core.targets import turned


@reward("progress")
class Progress(RewardTerm):
    """Reward the distance that the chassis moves forward; penalise moving back equally.

    Below the cap, the sum over a crossing is proportional to its length and does not depend on the
    speed: up to 0.33 m/s with decisions of 0.6 s. This term changes which policy is optimal;
    ``shaped_progress`` does not.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    elementwise: ClassVar[bool] = True
    distance: float = Field(
        0.2,
        gt=0.01,
        le=10,
        description="distance per decision at which the reward reaches its maximum, 1 [m]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 1]."""
        moved = t.after.position.T[0] - t.before.position.T[0]  # [m]
        return limited(moved / self.distance, -1.0, 1.0)


@reward("shaped_progress")
class ShapedProgress(Shaping):
    """Potential-based shaping by the distance to the last edge; changes no optimal policy."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    elementwise: ClassVar[bool] = True
    distance: float = Field(
        10.0,
        gt=0.1,
        le=1000,
        description="distance to the last edge at and beyond which Φ = -1 [m]",
    )

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Return Φ in [-1, 0]: 0 past the last edge, falling linearly with the distance to it."""
        left = profile.end - state.position.T[0]  # [m]
        return -limited(left / self.distance, 0.0, 1.0)


class Rocking(RewardTerm):
    """A penalty on turns of the chassis, up to a cap."""

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
    slope: float = Field(
        1.0,
        gt=0,
        le=1000,
        description="slope of the penalty; the cap of 1 is reached at 1/slope rad in a decision "
        "[1/rad]",
    )


@reward("swing")
class Swing(Rocking):
    """Penalise pitch variation within the decision, from poses at 100 Hz.

    Below the cap, the sum over an episode is proportional to its θ̂_R at 100 Hz (the measure
    ``pitch_variation_100hz``). Unlike ``pitch``, the term sees a chassis that rocks and returns
    within a decision. With ``at_decisions`` it does not; its sum is then proportional to the
    paper's θ̂_R (the measure ``pitch_variation_decisions``). It is 0 without a path.
    """

    at_decisions: bool = Field(
        False,
        description="whether only the pitch change from one decision to the next counts [-]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        pitch = t.path[..., 2]  # (…, S + 1) [rad]
        if self.at_decisions:
            pitch = pitch[..., :: max(1, pitch.shape[-1] - 1)]
        variation = np.add.reduce(abs(pitch[..., 1:] - pitch[..., :-1]), axis=-1)
        return -limited(self.slope * variation, 0.0, 1.0)


@reward("roll")
class Roll(Rocking):
    """Penalise the change of the roll from one decision to the next; 0 in the side plane.

    It is to ``roll_variation_100hz`` what ``swing`` with ``at_decisions`` is to the pitch's.
    """

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        return -limited(self.slope * abs(t.after.roll - t.before.roll), 0.0, 1.0)


@reward("travel")
class Travel(RewardTerm):
    """Penalise the angle by which the flippers turn: it costs wear and energy.

    It is -1 if the pairs turned by two whole steps in total. The term measures the motion, not the
    command: a command beyond the angle limit costs nothing, while a flipper that the ground pushes
    away does.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        return -limited(sum(turned(t)) / (2 * t.robot.angle_step), 0.0, 1.0)


@reward("time")
class Time(RewardTerm):
    """Charge the time that passes, 1 for each second, against waiting.

    Behind an obstacle a robot may drive on with its nose up, which saves the swing of coming down.
    """

    bounds: ClassVar[tuple[float, float]] = (-100.0, 0.0)
    elementwise: ClassVar[bool] = True

    def __call__(self, t: Transition) -> float:
        """Return minus the duration of the decision [s]."""
        return t.before.time - t.after.time


@reward("smoothness")
class Smoothness(RewardTerm):
    """Penalise a changed action; stopping costs half as much as reversing.

    It is -1 if all flippers reverse. This is the first-order temporal smoothness of Mysore et al.
    2021 ("Regularizing Action Policies for Smooth Control with Reinforcement Learning").
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        turns = list(zip(_by_joint(t.action), _by_joint(t.previous_action), strict=True))
        penalty: float = -sum(abs(turn - last) for turn, last in turns) / (2 * len(turns))
        return penalty


@reward("impact")
class Impact(RewardTerm):
    """Penalise the largest vertical acceleration of the chassis in the decision.

    The acceleration is the change of the vertical velocity at 100 Hz: the velocity before the
    decision, its mean over each sample period, and the velocity after the decision. Thus impacts
    between two decisions are seen too. It is 0 without a path.
    """

    bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)
    elementwise: ClassVar[bool] = True
    tolerance: float = Field(
        5.0, ge=0, le=1000, description="largest acceleration without a penalty [m/s²]"
    )
    worst: float = Field(
        30.0,
        gt=0,
        le=10_000,
        description="excess over the tolerance at which the reward is -1 [m/s²]",
    )

    def __call__(self, t: Transition) -> float:
        """Return the reward in [-1, 0]."""
        if t.path.shape[-2] < 2:
            return 0.0 * t.before.pitch
        rise = np.diff(t.path[..., 1]) / t.sample_period  # (…, S) [m/s]
        # Velocities before, within and after the decision, so that impacts at its ends are seen
        ends = t.before.velocity[..., 1:], t.after.velocity[..., 1:]
        velocity = np.concatenate([ends[0], rise, ends[1]], axis=-1)
        peak = np.abs(np.diff(velocity)).max(axis=-1) / t.sample_period
        return -limited(peak - self.tolerance, 0.0, self.worst) / self.worst


def _by_joint(action: Any) -> Any:
    """Return the turn of each joint: J integers, or J arrays (M,)."""
    return action if isinstance(action, tuple) else action.T
