"""From the messages of a robot's devices to safe targets of its flippers.

In: an exported policy; clouds, attitudes, joint angles and belt speeds with their times. Out: the
targets, whether the belts may run, and why.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from flipperctl.core import FloatArray
from flipperctl.core import observation as layout
from flipperctl.core.lidar.body import Body
from flipperctl.core.lidar.estimator import LidarEstimator
from flipperctl.core.lidar.ground import MapQuality, MapSettings
from flipperctl.core.lidar.matching import ScanMatcher
from flipperctl.core.lidar.messages import Belts, Joints, real, short
from flipperctl.core.lidar.outline import accuracy_of
from flipperctl.core.sensing import Measured, SensedGround
from flipperctl.core.targets import Action, alike, angles_of
from flipperctl.errors import MissingExtraError, PolicyError
from flipperctl.runtime.intake import Intake
from flipperctl.runtime.interface import Interface
from flipperctl.runtime.messages import (
    Attitude,
    Cloud,
    JointAngles,
    Limits,
    Odometry,
    RobotSetup,
)
from flipperctl.runtime.motion import PairMotion
from flipperctl.runtime.policy import OnnxPolicy
from flipperctl.runtime.states import DRIVES, Angles, Fault, States


@dataclass(frozen=True)
class Answer:
    """What the flippers and the belts shall do until the next step, or until it expires."""

    targets: Angles | None
    """Angle to turn each joint to, of pairs front and rear, in the robot's signs (J,) [rad].

    None in ``standby``, while it waits and before the first decision: then send the flippers
    nothing. As long as a pair was not seen to obey, it is its setpoint.
    """
    setpoints: Angles | None
    """Where the flippers shall be now on their way there, at the speed of the training [rad]."""
    drive: bool
    """Whether the belts may run."""
    state: Literal["waiting", "standby", "driving", "holding", "stopped"]
    """See ``flipperctl.runtime.states``; ``latched`` is a stop, too."""
    fault: str = ""
    """Stable name of the fault, as ``cloud_age``; empty without one."""
    reason: str = ""
    """What was found and what is allowed, of a fault or in standby; otherwise empty.

    While it holds or is stopped after a fault, both are of the last fault.
    """
    action: Action | None = None
    """The action, if this step decided: a row of ``interface.actions``, or rates."""
    risk: float | None = None
    """Probability of a failure soon, at the last decision; None before one, while the flippers are
    not driven, and for a file without a risk."""
    warning: bool = False
    """Whether the risk is the file's threshold or more."""
    latched: bool = False
    """Whether the belts stand until ``acknowledge`` or ``reset``."""
    time: float = math.nan
    """Time of the step, by its clock [s]; NaN if that was no time."""
    valid_for: float = 0.0
    """Time from then on after which this is no command any more [s]; see ``CommandWatch``."""


_UNTRIED = Fault("start", "no decision was tried yet", gap=True)
_FOLLOWS = "stall", "motion_slow", "motion_away"
"""Faults of a motion whose measured angles are right."""
_ON_TIME = 1e-6
"""Part of a step by which a decision may be early, for times that are sums of periods [s]."""


class FlipperController:
    """Decides at the period of the policy, and holds and then stops while it cannot.

    ``flipperctl.runtime.states`` has the states. While ``Odometry`` says that the belts do not
    drive ahead, it decides nothing: a policy has only seen belts that drive, and takes a parked
    robot for a stuck one.

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
        escape: bool = False,
        trusted: bool = False,
    ) -> None:
        """``log`` receives a line of JSON for each decision and each change of state.

        ``shadow``: someone else moves the flippers, and the answers only tell what the policy would
        do; that flippers do not follow is then no fault. ``escape``: whether a policy that warns
        draws its actions, as in the simulator; see ``OnnxPolicy``. ``trusted``: whether the
        flippers are known to obey, as simulated ones do, so that no first turn has to show it.

        Raises:
            MissingExtraError: onnxruntime is missing, or small_gicp for matched scans.
            PolicyError: the file is no exported policy, or a setting is not allowed.
        """
        self.policy = OnnxPolicy(path, escape=escape)
        self._setup, self._limits = setup or RobotSetup(), limits or Limits()
        self._log, self._shadow, self._trusted = log, shadow, trusted
        # Rhythm, limits and speeds of the training
        interface = self.policy.interface
        self._period, self._limit = interface.decision_period, interface.targets.limit
        self._turning = float(interface.robot.get("flipper_speed", math.inf))
        self._driving_speed = float(interface.robot.get("track_speed", 0.0))
        self.manual = False
        """Whether an operator drives: the controller stands by, and its map goes on."""
        self.reset()

    def reset(self, since: float = -math.inf) -> None:
        """Begin anew on level ground, as after the robot was carried: map and targets go.

        Messages stamped before ``since`` [s] tell of another place, and are ignored. The clock may
        be another one from now on.
        """
        self._states = States(self._limits)
        self._last: float | None = None
        self._begin(level=True, since=since)

    @property
    def pitch(self) -> float:
        """Pitch of the chassis by the latest messages, nose up positive [rad]."""
        return self._estimator.pose.pitch

    @property
    def map_points(self) -> FloatArray:
        """The points of the map along the robot, (P, 3) [m]: level, with its centre as origin."""
        return self._estimator.map_points()

    def acknowledge(self) -> None:
        """Let a robot go on that stopped until it is told to; its map stays."""
        if self._states.acknowledge() == "waiting":
            self._await()

    def _begin(self, *, level: bool, since: float = -math.inf) -> None:
        self._estimator = new_estimator(self.policy.interface, self._setup, level=level)
        joints = len(self.policy.interface.joints)
        self._intake = Intake(self._setup, self._limits, since=since, joints=joints)
        self._begun: float | None = None  # time of the first step [s]
        self._decided = False
        self._answer = Answer(None, None, False, "waiting")
        self.ground: SensedGround | None = None
        """The ground of the last try to decide."""
        self._await()

    def _await(self) -> None:
        """Command nothing until a decision is made, and compare the motion from then on."""
        self._motions = {} if self._shadow else self._new_motions()
        self._due = -math.inf  # time of the next decision
        self._undecided: Fault | None = _UNTRIED  # why the last try to decide failed
        self._stall: tuple[Fault, float] | None = None  # a fault of the motion, and its end [s]
        self._release()

    def _new_motions(self) -> dict[str, PairMotion]:
        interface = self.policy.interface
        delay = float(interface.robot.get("actuator_delay", 0.0))
        numbers = float(np.abs(interface.actions).max()), self._period, self._turning, delay
        joints = interface.joints
        motions = {name: PairMotion(name, *numbers, self._limits) for name in joints}
        for motion in motions.values():
            motion.obeys = self._trusted
        return motions

    def _release(self) -> None:
        """Command nothing; the policy forgets its earlier observations."""
        self._targets: Angles | None = None  # the policy's, or where the flippers are held
        self._setpoints: Angles | None = None
        self._shown: Angles | None = None  # the targets of the answer
        self._held = False
        self.policy.reset()

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
        if self._shadow and self._states.state == "latched":
            self.acknowledge()  # nothing is driven, and the rest of a recording counts too
        fault = self._clock_fault(now)
        if fault is not None:
            self._states.update(self._last or 0.0, fault)
            return self._say(now, fault, None)
        now = float(now)  # which numpy may have made
        elapsed, self._last = now - (now if self._last is None else self._last), now
        self._begun = now if self._begun is None else self._begun
        messages = {"odometry": odometry, "attitude": attitude, "joints": joints, "cloud": cloud}
        action = None
        # Devices first, then the state, then a decision if one is due
        try:
            self._advance(now, elapsed)  # towards the targets of the steps before
            fault = self._receive(now, messages)
            self._states.manual = self.manual
            state = self._states.update(now, fault or self._undecided)
            if state == "driving" and (self._held or self._targets is None):
                self._due = min(self._due, now)
            blocked = state == "latched" or self._states.event == "unsure"
            if fault is None and not blocked and now >= self._due - _ON_TIME:
                action = self._decide(now)
        except Exception as error:  # noqa: BLE001 - a robot must get an answer, whatever was wrong
            text = " ".join(str(error).split()) or type(error).__name__
            fault = self._undecided = Fault("inference", text)
            self._states.update(now, fault)
        fault = fault or self._undecided
        self._hold_or_release(now, fault)
        return self._say(now, fault, action)

    def _receive(self, now: float, messages: Mapping[str, object]) -> Fault | None:
        """Take in messages and return what is wrong; ``messages``: the scan comes last.

        It enters the map at the pose that the others tell.
        """
        for device, stamp, message in self._intake.receive(now, **messages):
            if device == "attitude" and "odometry" not in self._intake.known:
                speed = self._driving_speed if self._answer.drive else 0.0
                self._estimator.update(Measured("odometry", stamp, Belts(speed)))
            self._estimator.update(Measured(device, stamp, message))
            if isinstance(message, Belts):
                self._states.belts(now, message.speed)
            elif isinstance(message, Joints):
                self._compare(now, message)

        # Of several faults, one that stops at once comes first.
        faults = self._stall_fault(now), self._intake.fault(now), self._speed_fault(now)
        present = [fault for fault in faults if fault is not None]
        return max(present, key=lambda fault: fault.at_once, default=None)

    def _clock_fault(self, now: object) -> Fault | None:
        """Return a fault if the clock is no clock; after a jump nothing old is of use."""
        time = real(now)
        if time is None or not math.isfinite(time):
            text = f"the time is {short(now)}; a finite number is allowed"
            return Fault("clock", text, at_once=True)
        if self._last is None:
            return None
        elapsed, since = time - self._last, self._intake.since
        if 0 <= elapsed <= self._limits.clock_jump:
            return None
        if elapsed > 0 and not self._intake.known:  # as of a simulated clock that begins
            self._begun = None
            return None
        # It may stand on an obstacle.
        self._begin(level=False, since=since if elapsed > 0 else -math.inf)
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

    def _compare(self, now: float, joints: Joints) -> None:
        """Compare the new angles with the commands; after a fault, hold the flippers there."""
        if self._held and self._stall is None:
            return
        # Each pair is judged by its own motion; after a fault of one, both are held.
        motions, sides = self._motions.values(), self._intake.sides
        if self._held:
            driven, pairs = self._states.driven, zip(motions, sides, strict=False)
            faults = [motion.hold(now, angles, driven=driven) for motion, angles in pairs]
        else:
            targets = zip(motions, self._targets or [None] * len(sides), sides, strict=False)
            faults = [motion.compare(now, target, angles) for motion, target, angles in targets]
        fault = next((fault for fault in faults if fault is not None), None)
        if fault is not None:
            self._stall = fault, now + self._limits.stall_hold
            if self._targets is not None and not self._held:
                self._hold(joints, faults)

    def _stall_fault(self, now: float) -> Fault | None:
        if self._stall is not None and now >= self._stall[1] - _ON_TIME:
            self._stall = None
        return None if self._stall is None else self._stall[0]

    def _decide(self, now: float) -> Action | None:
        """Return the action; None if there is none, and ``_undecided`` says why.

        It is tried once in a period, since an estimate also corrects the map. In standby it is
        tried without effect: what would keep a decision from being made is a fault there, too,
        before the belts start.
        """
        late = now - self._due > self._period  # or the first decision
        self._due = now + self._period if late else self._due + self._period
        ground, angles = self._estimator.estimate(now)
        self.ground = ground
        self._undecided = self._uncertain(ground)
        if self._undecided is not None:
            self._states.update(now, self._undecided)
            return None
        measured = angles_of(angles)
        assert ground.heights is not None  # of a map
        # In standby a decision is tried too, so that what would prevent it shows before the belts
        # start.
        pose, roll = self._estimator.pose, angles.roll if self.policy.interface.sides else None
        action = self.policy.act(
            layout.assemble(ground.heights, measured, pitch=angles.pitch, roll=roll),
            (pose.x, pose.y, pose.z),
        )
        if self._states.update(now, None) != "driving":
            self.policy.reset()
            return None
        # A drive begins where the flippers are, and ends within the limits by decisions alone.
        if self._targets is None or self._setpoints is None or self._held:
            self._targets = self._setpoints = measured
            self._held = False
            for motion in self._motions.values():
                motion.begin()
        targets = self.policy.next_targets(self._targets, measured, action)
        self._targets, self._decided = tuple(targets.tolist()), True
        for motion in self._motions.values():
            motion.decide()
        self._advance(now, 0.0)
        return action

    def _uncertain(self, ground: SensedGround) -> Fault | None:
        """Return a fault if too little ground is known, or joints differ before the first turn."""
        # Enough ground was seen, and the joints of a pair are where one command may turn them.
        covered = 1.0 if ground.seen is None else float(np.mean(ground.seen))
        least = self._limits.coverage
        if covered < least:
            seen, limit = (f"{100 * share:.3g} %" for share in (covered, least))
            text = f"ground was seen in {seen} of the bins; {limit} or more is allowed"
            return Fault("coverage", text, gap=True)
        pairs = zip(self._motions.values(), self._intake.sides, strict=False)
        return next((fault for motion, pair in pairs if (fault := motion.unlike(pair))), None)

    def _advance(self, now: float, elapsed: float) -> None:
        """Move the setpoints towards the targets, no faster than in the training."""
        if self._targets is None or self._setpoints is None or self._held:
            return
        # A pair that was not seen to obey stays at first, to see whether it does.
        points, shown, joints = [], [], self.policy.interface.joints
        for name, target, point in zip(joints, self._targets, self._setpoints, strict=True):
            motion = self._motions.get(name)
            most = 0.0 if motion is not None and motion.probes(now) else self._turning * elapsed
            points.append(point + min(most, max(-most, target - point)))
            shown.append(target if motion is None else motion.command(now, points[-1], target))
        self._setpoints, self._shown = tuple(points), tuple(shown)

    def _hold_or_release(self, now: float, fault: Fault | None) -> None:
        """Hold the flippers at a fault, but in a short gap; command nothing before a drive."""
        state, since = self._states.state, self._states.since
        if state in ("waiting", "standby"):
            if self._targets is not None:
                self._release()
        elif state != "driving" and self._targets is not None and not self._held:
            gap = state == "holding" and fault is not None and fault.gap
            joints = self._intake.joints
            if joints is not None and not (gap and now - (since or now) <= self._limits.short_gap):
                self._hold(joints)

    def _hold(self, joints: Joints, faults: Sequence[Fault | None] = ()) -> None:
        """Hold the flippers where they are; the policy forgets its earlier observations.

        ``faults`` of the motion of each joint, if there are any; where its angles are in doubt,
        its commands count.
        """
        at, names = [], self.policy.interface.joints
        faults = faults or [None] * len(names)
        for name, angle, fault in zip(names, angles_of(joints), faults, strict=True):
            motion = self._motions.get(name)
            right = motion is None or (motion.obeys if fault is None else fault.name in _FOLLOWS)
            at.append(angle if motion is None or right else motion.angle(angle))
        self._targets = self._setpoints = self._shown = tuple(at)
        self._held = True
        self.policy.reset()

    def _say(self, now: float, fault: Fault | None, action: Action | None) -> Answer:
        """Return the answer, and log it if it is a decision or another state."""
        state, policy, cause = self._states.state, self.policy, self._states.cause
        # A stop, and the time after a fault, show the fault that caused them.
        latched = state == "latched"
        name, reason = "", self._states.reason() if state == "standby" else ""
        if cause is not None and (latched or (fault is None and self._states.event == "unsure")):
            until = "it is acknowledged" if latched else "there was no fault for a while"
            name, reason = cause.name, f"{cause.reason}; it goes on when {until}"
        elif fault is not None:
            name, reason = fault.name, fault.reason

        # The answer in the robot's own signs
        time = real(now)
        time = time if time is not None and math.isfinite(time) else None
        answer = Answer(
            self._theirs(self._shown),
            self._theirs(self._setpoints),
            state in DRIVES and self._stall is None,
            "stopped" if state == "latched" else state,
            name,
            reason,
            action,
            policy.risk,
            policy.warning,
            latched,
            math.nan if time is None else time,
            self._limits.valid_for,
        )

        # Each decision and each change of state is a line of the log.
        before, self._answer = self._answer, answer
        changed = (answer.state, answer.fault) != (before.state, before.fault)
        if self._log is not None and (changed or action is not None):
            line = {"time": short(now) if time is None else time}
            line |= {k: v for k, v in asdict(answer).items() if k not in ("time", "valid_for")}
            if policy.interface.risk is None:  # the lines of files without a risk stay
                del line["risk"], line["warning"]
            self._log(json.dumps(line))
        return answer

    def _theirs(self, angles: Angles | None) -> Angles | None:
        if angles is None:
            return None
        signs = alike((self._setup.signs.front, self._setup.signs.rear), len(angles))
        return tuple(sign * angle for sign, angle in zip(signs, angles, strict=True))


_LENGTHS = "chassis_length", "flipper_length", "track_radius"


def new_estimator(interface: Interface, setup: RobotSetup, *, level: bool = True) -> LidarEstimator:
    """Return the estimator of ``perception=lidar`` for a policy and its robot.

    ``level``: whether the robot stands on level ground now. A policy whose file states no map, as
    of a training without a LiDAR, gets the default one.
    """
    # The robot as the policy's file states it, with the widths of the setup
    missing = [name for name in _LENGTHS if name not in interface.robot]
    if missing:
        raise PolicyError(f"the policy's file does not state robot.{missing[0]}; export it again")
    body = Body(
        **{name: float(interface.robot[name]) for name in _LENGTHS},
        chassis_width=setup.chassis_width,
        overall_width=setup.overall_width,
    )

    # The map of the training, with the accuracy of this robot
    settings = MapSettings(
        interface.bins,
        interface.bin_width,
        interface.highest,
        interface.map_quality or MapQuality(),
        accuracy_of(setup.pose, setup.range_bias, setup.tilt_error),
        interface.sides,
    )
    try:
        matcher = ScanMatcher() if setup.pose == "matched" else None
    except ImportError as error:
        raise MissingExtraError(  # not by the extra, which would bring the simulators
            "pose='matched' needs small_gicp: pip install small_gicp"
        ) from error
    return LidarEstimator(body, setup.mount, settings, matcher, level=level)
