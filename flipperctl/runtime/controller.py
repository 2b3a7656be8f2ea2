"""From the messages of a robot's devices to safe targets of its flippers.

In: an exported policy; clouds, attitudes, joint angles and belt speeds with their times. Out: the
targets, whether the belts may run, and why.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from numbers import Real
from pathlib import Path
from typing import Literal

import numpy as np

from flipperctl.core import observation as layout
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality, MapSettings
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.core.lidar.messages import Belts
from flipperctl.core.lidar.outline import accuracy_of
from flipperctl.core.sensing import Measured
from flipperctl.core.targets import Action
from flipperctl.errors import MissingExtraError, PolicyError
from flipperctl.runtime.intake import Fault, Intake
from flipperctl.runtime.interface import Interface
from flipperctl.runtime.messages import (
    Attitude,
    Cloud,
    JointAngles,
    Limits,
    Odometry,
    RobotSetup,
)
from flipperctl.runtime.policy import OnnxPolicy

Pair = tuple[float, float]
State = Literal["waiting", "standby", "driving", "holding", "stopped"]


@dataclass(frozen=True)
class Answer:
    """What the flippers and the belts shall do until the next step."""

    targets: Pair | None
    """Angles to turn the front and the rear flippers to, in the robot's signs [rad].

    None as long as no angle was measured: then leave the flippers as they are.
    """
    setpoints: Pair | None
    """Where the flippers shall be now on their way there, at the speed of the training [rad]."""
    drive: bool
    """Whether the belts may run."""
    state: State
    """``waiting`` for the first inputs, ``driving``, ``holding`` the flippers, or ``stopped``.

    In ``standby`` the flippers are held too: nothing is wrong, and the belts do not drive ahead.
    """
    fault: str = ""
    """Stable name of the fault, as ``cloud_age``; empty without one."""
    reason: str = ""
    """What was found and what is allowed, of a fault or in standby; otherwise empty."""
    action: Action | None = None
    """The action, if this step decided: a row of ``interface.actions``, or rates."""
    risk: float | None = None
    """Probability of a failure soon, at the last decision; None before one, while the flippers are
    not driven, and for a file without a risk."""
    warning: bool = False
    """Whether the risk is the file's threshold or more."""


_APPROACH = 0.02
"""Reduction of the error that counts as an approach [rad]."""


class _StallDetector:
    """Finds flippers that miss their targets and come no closer for ``limits.stall_time``."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        # Of the last approach: the smallest error since [rad], and its time [s].
        self._pairs: dict[str, tuple[float, float]] = {}

    def stalled(self, now: float, targets: Pair, angles: Pair) -> list[str]:
        """Return the pairs that have not approached their targets for too long; all in [rad]."""
        stalled = []
        for name, target, angle in zip(("front", "rear"), targets, angles, strict=True):
            error = abs(target - angle)
            least, since = self._pairs.get(name, (error, now))
            if error <= self._limits.stall_error or error < least - _APPROACH:
                least, since = error, now
            elif error > least + self._limits.stall_error:  # another target was set
                least = error
            self._pairs[name] = least, since
            if now - since >= self._limits.stall_time:
                stalled.append(name)
        return stalled


class _Standby:
    """Finds belts that have been slower than ``limits.standby_speed`` for ``standby_after``.

    Once they have, it takes ``standby_until`` of a larger speed to end that: a single one, as from
    slack tracks or a coarse encoder, moves no flipper of a parked robot. It takes what the belts'
    encoders measure, not how the robot moves: belts that slip under a robot that is stuck drive,
    and belts that were stopped do not.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._speed = math.nan  # as on a robot without encoders of its belts
        self._driven, self._since = True, 0.0  # what the last speed says, and since when [s]
        self._stands = False

    def update(self, now: float, speed: float) -> None:
        """Receive a speed of the belts, ahead positive [m/s].

        If the first speed of all is slow, the belts have never driven, and that counts at once.
        """
        driven = speed >= self._limits.standby_speed
        if math.isnan(self._speed):
            self._stands = not driven
        self._speed = speed
        if driven is not self._driven:
            self._driven, self._since = driven, now

    def stands(self, now: float) -> bool:
        """Return whether the flippers stand by; False before any speed."""
        if self._stands is self._driven:  # the last speeds say otherwise
            wait = self._limits.standby_until if self._driven else self._limits.standby_after
            if now - self._since >= wait - 1e-9:  # for sums of periods
                self._stands = not self._driven
        return self._stands

    def reason(self) -> str:
        """Return a sentence with the speed, for an answer in standby."""
        return (
            f"the belts drive at {self._speed:.2f} m/s; the flippers are held until that is "
            f"{self._limits.standby_speed:g} m/s or more"
        )


_ON_TIME = 1e-6
"""Part of a step by which a decision may be early, for times that are sums of periods [s]."""


class FlipperController:
    """Decides at the period of the policy, and holds and then stops while it cannot.

    While ``Odometry`` says that the belts do not drive ahead, it decides nothing and holds the
    flippers: a policy has only seen belts that drive, and takes a parked robot for a stuck one.

    Call ``step`` whenever a message has arrived, and at least every 0.1 s, from one thread. The
    simulator's ``perception=lidar`` uses the same estimator, so a policy perceives on the robot
    what it was judged with.
    """

    def __init__(
        self,
        path: str | Path,
        setup: RobotSetup | None = None,
        limits: Limits | None = None,
        log: Callable[[str], object] | None = None,
        *,
        shadow: bool = False,
        escape: bool = True,
    ) -> None:
        """``log`` receives a line of JSON for each decision and each change of state.

        ``shadow``: someone else moves the flippers, and the answers only tell what the policy would
        do; that flippers do not follow is then no fault. ``escape``: whether a
        policy that warns draws its actions, see ``OnnxPolicy``.

        Raises:
            MissingExtraError: onnxruntime is missing, or small_gicp for matched scans.
            PolicyError: the file is no exported policy, or a setting is not allowed.
        """
        self.policy = OnnxPolicy(path, escape=escape)
        self._setup, self._limits = setup or RobotSetup(), limits or Limits()
        self._log, self._shadow = log, shadow
        interface = self.policy.interface
        self._period, self._limit = interface.decision_period, interface.targets.limit
        self._turning = float(interface.robot.get("flipper_speed", math.inf))
        self._driving_speed = float(interface.robot.get("track_speed", 0.0))
        self._last: float | None = None
        self.reset()

    def reset(self) -> None:
        """Begin anew on level ground, as after the robot was carried: map and targets go."""
        self._begin(level=True)

    def _begin(self, *, level: bool) -> None:
        self._estimator = new_estimator(self.policy.interface, self._setup, level=level)
        self.policy.reset()
        self._intake = Intake(self._setup, self._limits)
        self._stalls = _StallDetector(self._limits)
        self._standby = _Standby(self._limits)
        self._standing = False  # whether the flippers stand by
        self._targets: Pair | None = None
        self._setpoints: Pair | None = None
        self._begun: float | None = None  # time of the first step [s]
        self._due = -math.inf  # time of the next decision
        self._faulty_since: float | None = None
        self._held_until = -math.inf
        self._decided = False
        self._undecided: Fault | None = None  # why the last try to decide failed
        self._answer = Answer(None, None, False, "waiting")

    def step(
        self,
        now: float,
        cloud: Cloud | None = None,
        attitude: Attitude | None = None,
        joints: JointAngles | None = None,
        odometry: Odometry | None = None,
    ) -> Answer:
        """Take in what has arrived and return what to do.

        ``now``: a clock that never goes back [s]. Nothing is raised for bad input: whatever keeps
        the controller from deciding is the answer's ``reason``.
        """
        jump = self._clock_fault(now)
        if jump is not None:
            return self._say(now, jump, None)
        now = float(now)  # which numpy may have made
        elapsed, self._last = now - (now if self._last is None else self._last), now
        self._begun = now if self._begun is None else self._begun
        self._advance(elapsed)  # towards the targets of the steps before
        messages = {"odometry": odometry, "attitude": attitude, "joints": joints, "cloud": cloud}
        # The scan comes last: it enters the map at the pose that the others tell.
        action = None
        try:
            for device, stamp, message in self._intake.receive(now, **messages):
                if device == "attitude" and "odometry" not in self._intake.known:
                    speed = self._driving_speed if self._answer.drive else 0.0
                    self._estimator.update(Measured("odometry", stamp, Belts(speed)))
                self._estimator.update(Measured(device, stamp, message))
                if isinstance(message, Belts):
                    self._standby.update(now, message.speed)
            fault = self._intake.fault(now) or self._speed_fault(now) or self._stall_fault(now)
            if fault is None:
                self._stand_by_or_begin(now)
                if now >= self._due - _ON_TIME:
                    action = self._decide(now)
        except Exception as error:  # noqa: BLE001 - a robot must get an answer, whatever was wrong
            fault = self._undecided = Fault(
                "inference", " ".join(str(error).split()) or type(error).__name__
            )
        return self._say(now, fault or self._undecided, action)

    def _clock_fault(self, now: object) -> Fault | None:
        """Return a fault if the clock is no clock; after a jump nothing old is of use."""
        time = _finite(now)
        if time is None:
            text = f"the time is {_short(now)}; a finite number is allowed"
            return Fault("clock", text, at_once=True)
        if self._last is None:
            return None
        elapsed = time - self._last
        if 0 <= elapsed <= self._limits.clock_jump:
            return None
        self._begin(level=False)  # it may stand on an obstacle
        self._last = time
        return Fault(
            "clock_jump",
            f"the clock went on by {elapsed:.2f} s; 0 to {self._limits.clock_jump:g} s is allowed",
            at_once=True,
        )

    def _speed_fault(self, now: float) -> Fault | None:
        """Return a fault for as long as the first speed of the belts may still come."""
        longest, begun = self._limits.ages.odometry, self._begun or 0.0
        if self._decided or "odometry" in self._intake.known or now - begun >= longest - _ON_TIME:
            return None
        text = f"no odometry was received yet; a robot without it decides after {longest:g} s"
        return Fault("odometry_missing", text)

    def _stall_fault(self, now: float) -> Fault | None:
        joints = self._intake.joints
        if joints is None or self._targets is None or self._shadow or not self._decided:
            return None
        angles = joints.front, joints.rear
        stalled = self._stalls.stalled(now, self._targets, angles)
        if stalled and self._standing:  # their operator turns them
            self._hold()
        elif stalled:
            self._stalled = " and ".join(stalled)
            self._held_until = now + self._limits.stall_hold
            self._targets = self._setpoints = self._within(angles)  # do not push
            self._stalls = _StallDetector(self._limits)
        if now < self._held_until:
            return Fault(
                "stall",
                f"the {self._stalled} flippers do not follow; they are held where they are for "
                f"{self._limits.stall_hold:g} s",
            )
        return None

    def _stand_by_or_begin(self, now: float) -> None:
        """Hold the flippers once the belts do not drive ahead; begin an episode once they do."""
        before, self._standing = self._standing, self._standby.stands(now)
        if self._standing == before:
            return
        self._hold()
        if not self._standing:
            self._due = min(self._due, now)

    def _decide(self, now: float) -> Action | None:
        """Return the action; None if there is none, and ``_undecided`` says why.

        It is tried once in a period, since an estimate also corrects the map. In standby it is
        tried without effect: what would keep a decision from being made is a fault there, too,
        before the belts start.
        """
        late = now - self._due > self._period  # or the first decision
        self._due = now + self._period if late else self._due + self._period
        ground, angles = self._estimator.estimate(now)
        covered = 1.0 if ground.seen is None else float(np.mean(ground.seen))
        least = self._limits.coverage
        if covered < least:
            text = f"ground was seen in {covered:.0%} of the bins; {least:.0%} or more is allowed"
            self._undecided = Fault("coverage", text)
            return None
        if self._faulty_since is not None:  # the flippers may have been moved since
            self._hold()
        measured = front, rear = angles.front, angles.rear
        assert ground.heights is not None  # of a map
        pose = self._estimator.pose
        action = self.policy.act(
            layout.assemble(ground.heights, front=front, rear=rear, pitch=angles.pitch),
            (pose.x, pose.y, pose.z),
        )
        if self._standing:
            self.policy.reset()
            self._undecided = None
            return None
        if self._targets is None or self._setpoints is None:
            self._targets = self._setpoints = self._within(measured)
        front, rear = self.policy.next_targets(self._targets, measured, action).tolist()
        self._targets = self._within((front, rear))
        self._decided, self._undecided = True, None
        return action

    def _within(self, angles: Pair) -> Pair:
        front, rear = (min(self._limit, max(-self._limit, angle)) for angle in angles)
        return front, rear

    def _advance(self, elapsed: float) -> None:
        """Move the setpoints towards the targets, no faster than in the training."""
        if self._targets is None or self._setpoints is None:
            return
        most = self._turning * elapsed
        front, rear = (
            point + min(most, max(-most, target - point))
            for point, target in zip(self._setpoints, self._targets, strict=True)
        )
        self._setpoints = front, rear

    def _say(self, now: float, fault: Fault | None, action: Action | None) -> Answer:
        """Return the answer, and log it if it is a decision or another state."""
        state = self._state(fault)
        reason = self._standby.reason() if state == "standby" else ""
        name, reason = (fault.name, fault.reason) if fault else ("", reason)
        targets, setpoints = self._theirs(self._targets), self._theirs(self._setpoints)
        drive, policy = state in ("standby", "driving", "holding"), self.policy
        answer = Answer(
            targets, setpoints, drive, state, name, reason, action, policy.risk, policy.warning
        )
        before, self._answer = self._answer, answer
        changed = (answer.state, answer.fault) != (before.state, before.fault)
        if self._log is not None and (changed or action is not None):
            time = _finite(now)
            line = {"time": _short(now) if time is None else time, **asdict(answer)}
            if policy.interface.risk is None:  # the lines of files without a risk stay
                del line["risk"], line["warning"]
            self._log(json.dumps(line))
        return answer

    def _state(self, fault: Fault | None) -> State:
        """Return what to do: hold at a fault, and stop if it lasts."""
        if fault is None:
            self._faulty_since = None
            return "standby" if self._standing else "driving"
        now = self._last or 0.0
        if self._faulty_since is None or self._targets is None:  # no angle was known until now
            self._hold()
        self._faulty_since = now if self._faulty_since is None else self._faulty_since
        if fault.at_once:
            return "stopped"
        if not self._decided:
            return "waiting"
        return "holding" if now - self._faulty_since < self._limits.stop_after else "stopped"

    def _hold(self) -> None:
        """Hold the flippers where they are; the policy forgets its earlier observations."""
        joints = self._intake.joints
        if joints is not None:
            self._targets = self._setpoints = self._within((joints.front, joints.rear))
            self._stalls = _StallDetector(self._limits)
        self.policy.reset()

    def _theirs(self, pair: Pair | None) -> Pair | None:
        signs = self._setup.signs
        return None if pair is None else (signs.front * pair[0], signs.rear * pair[1])


_LENGTHS = "chassis_length", "flipper_length", "track_radius"


def new_estimator(interface: Interface, setup: RobotSetup, *, level: bool = True) -> LidarEstimator:
    """Return the estimator of ``perception=lidar`` for a policy and its robot.

    ``level``: whether the robot stands on level ground now. A policy whose file states no map, as
    of a training without a LiDAR, gets the default one.
    """
    missing = [name for name in _LENGTHS if name not in interface.robot]
    if missing:
        raise PolicyError(f"the policy's file does not state robot.{missing[0]}; export it again")
    body = Body(
        **{name: float(interface.robot[name]) for name in _LENGTHS},
        chassis_width=setup.chassis_width,
        overall_width=setup.overall_width,
    )
    settings = MapSettings(
        interface.bins,
        interface.bin_width,
        interface.highest,
        interface.map_quality or MapQuality(),
        accuracy_of(setup.pose, setup.range_bias, setup.tilt_error),
    )
    try:
        matcher = ScanMatcher() if setup.pose == "matched" else None
    except ImportError as error:
        raise MissingExtraError(
            "pose='matched' needs small_gicp, which is not installed; run pip install small_gicp"
        ) from error
    return LidarEstimator(body, setup.mount, settings, matcher, level=level)


def _finite(number: object) -> float | None:
    """Return a finite real number, of Python or numpy; None for anything else."""
    if isinstance(number, bool) or not isinstance(number, Real):
        return None
    try:
        found = float(number)
    except OverflowError:
        return None
    return found if math.isfinite(found) else None


def _short(value: object) -> str:
    """Return a value as text of at most 40 characters."""
    try:
        return str(value)[:40]
    except ValueError:  # Python writes no integer of more than 4300 digits
        return type(value).__name__
