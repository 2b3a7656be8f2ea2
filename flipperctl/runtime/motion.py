"""Whether the flippers turn as they are commanded: one comparison of both, for each pair.

In: the commanded and the measured angles of a pair, over time. Out: a fault that names what is
wrong, and where the pair is if the commands are right and the measurements are not.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence

from flipperctl.runtime.messages import Limits
from flipperctl.runtime.states import Fault

_DEVIATION = 0.03
"""Motion against a command that counts [rad]."""
_MOVED = 0.01
"""Motion that is no noise, and in a command that is no rest [rad]."""
_ENOUGH = 0.4
"""Part of a step after which a turn is judged: half a decision's, less rounding [-]."""
_APART = 0.15
"""Largest difference of left and right joints, which one command would turn together [rad]."""
_JUMP, _FASTER = 0.1, 8.0
"""Step of two measured angles [rad], and its speed per flipper speed [-], from which the unit is
wrong: in degrees it is 57 times as fast, or noisy."""
_AGAIN = 1.0
"""Time between two of these without a command that tell the same [s]."""
_INSTANTS = 5
"""Instants of a decision's time at which a pair is farther and farther off, if it is moved [-]."""
_SETTLED = 0.3
"""Time after which a load moves a pair no more, once the belts stand [s]; 0.2 in simulations."""


class PairMotion:
    """Compares the commands of a pair with its angles, from the first command of a drive on.

    Until the pair has obeyed a turn, measured angles must stay within the commands of the last
    decision and the present target: little motion out of that range is a fault that stops at once,
    and the first commands must be: stay. Then signs and units are right, and what turns the pair
    elsewhere is a load, or a motor that runs away. Both are as fast, but a load ends with the
    drive: the pair is held while the belts stand, and one that still goes on runs away.
    """

    def __init__(
        self, name: str, step: float, period: float, speed: float, delay: float, limits: Limits
    ) -> None:
        """``step``: turn by an action [rad]; ``period`` of decisions [s].

        ``speed`` [rad/s] and ``delay`` [s] of the flippers in the training.
        """
        self._name, self._step, self._period, self._speed = name, step, period, speed
        self._limits, self._late = limits, period / 2 + delay
        self.obeys = False
        """Whether the pair has followed a turn."""
        self._slow = 0  # turns in succession that were too slow
        self._commands: deque[tuple[float, float, float]] = deque()  # time, angle, its target
        self._angles: deque[tuple[float, tuple[float, ...]]] = deque()  # time and measured ones
        self._last: tuple[float, tuple[float, ...]] | None = None  # time and measured angles
        self._jumped = -math.inf  # when an angle last stepped faster than flippers turn [s]
        self.begin()

    def begin(self) -> None:
        """Begin anew with the next command."""
        self._commands.clear()
        self._angles.clear()
        self._begun: float | None = None  # time of the first command
        self._missed: float | None = None  # since when it has been behind
        self._turn: tuple[float, float, float] | None = None  # way, command and angle at its start
        self._judged, self._mirrored = False, False
        self._rest: tuple[float, float | None] = math.inf, None  # from when it rests, and where

    def unlike(self, angles: Sequence[float]) -> Fault | None:
        """Return a fault if the first command would turn joints of the pair that differ [rad]."""
        apart = max(angles) - min(angles)
        if self.obeys or apart <= _APART:
            return None
        text = f"the {self._name} joints differ by {apart:.2f} rad; {_APART:g} is allowed at first"
        return Fault("joints_pair", text, gap=True)

    def probes(self, now: float) -> bool:
        """Return whether the command must stay where it is, to see whether the pair does."""
        return not self.obeys and (self._begun is None or now - self._begun < self._late)

    def decide(self) -> None:
        """Take note of another decision: the next turn is judged anew."""
        if self._judged:
            self._turn = None

    def command(self, now: float, angle: float, target: float) -> float:
        """Receive what is commanded from now on and where that goes; return the target [rad].

        A pair that has not obeyed yet has none beyond the command.
        """
        self._begun = now if self._begun is None else self._begun
        target = target if self.obeys else angle
        # Commands of the time in which a motion is judged
        self._commands.append((now, angle, target))
        while len(self._commands) > 2 and self._commands[1][0] <= now - 2 * self._late:
            self._commands.popleft()
        return target

    def compare(self, now: float, target: float | None, angles: Sequence[float]) -> Fault | None:
        """Return what is wrong by the measured angles, of the pair or of its left and right [rad].

        ``target``: where the command goes [rad]; None: nothing is commanded.
        """
        # Jumps show without a command, too.
        fault = self._jumps(now, target is not None, tuple(angles))
        if fault is not None or target is None or not self._commands:
            return fault
        if self._angles and len(self._angles[-1][1]) != len(angles):
            self._angles.clear()  # left and right are measured now and then
        self._angles.append((now, tuple(angles)))
        while self._angles[0][0] < now - 2 * self._late:
            self._angles.popleft()
        away = self._leaves(now) if self.obeys else self._deviates(now)
        return away or self._lags(now, target)

    def hold(self, now: float, angles: Sequence[float], *, driven: bool) -> Fault | None:
        """Return a fault if a pair that is held for its motion goes on while the belts stand.

        ``angles``: measured [rad]; ``driven``: whether the belts do not stand yet.
        """
        angle = sum(angles) / len(angles)
        begun, rest = self._rest
        if driven or begun == math.inf:
            self._rest = now + _SETTLED, None
        elif rest is None and now >= begun:
            self._rest = begun, angle
        elif rest is not None and abs(angle - rest) > 2 * _DEVIATION:
            turned = f"{angle - rest:+.2f} rad while they were held and the belts stood"
            text = f"the {self._name} flippers turned by {turned}"
            return Fault("motion_runaway", text, at_once=True)
        return None

    def angle(self, measured: float) -> float:
        """Return where a pair that was not seen to obey is by its commands [rad]."""
        if not self._commands:
            return measured
        if self._last is not None and self._last[0] - self._jumped < _AGAIN:
            return 0.0  # in degrees, all that is measured within π is near 0
        return -measured if self._mirrored else measured

    def _jumps(self, now: float, commanded: bool, angles: tuple[float, ...]) -> Fault | None:
        """Compare steps of the angles with the speed of the flippers, until the pair has obeyed.

        ``commanded``: whether it is commanded; otherwise an operator may make a single step.
        """
        last, self._last = self._last, (now, angles)
        if self.obeys or last is None or len(last[1]) != len(angles):
            return None
        steps = [math.remainder(b - a, math.tau) for a, b in zip(last[1], angles, strict=True)]
        passed, most = now - last[0], max(map(abs, steps))
        if most <= max(_JUMP, _FASTER * self._speed * passed):
            return None
        before, self._jumped = self._jumped, now
        if not commanded and now - before > _AGAIN:
            return None
        text = (
            f"the {self._name} flippers were measured to turn by {most:.2f} rad in {passed:.3f} s"
        )
        return Fault("motion_scale", text, at_once=True, strike=True)

    def _deviates(self, now: float) -> Fault | None:
        """Compare the range of the commands with the motion out of it."""
        # The range of the commands, and where the pair was when it began
        low = min(min(angle, target) for _, angle, target in self._commands)
        high = max(max(angle, target) for _, angle, target in self._commands)
        before, after = self._angles[0][1], self._angles[-1][1]
        previous = self._angles[-2][1] if len(self._angles) > 1 else after
        # Two samples, for the noise; the left and the right joint may rest at other angles.
        moved = [(a + b) / 2 - c for a, b, c in zip(after, previous, before, strict=True)]
        start = sum(before) / len(before)
        outside = [_beyond(start + m, low, high) - _beyond(start, low, high) for m in moved]
        wrong = [m for m, out in zip(moved, outside, strict=True) if out > _DEVIATION]

        # The farthest motion, beside what was commanded
        turned = self._commands[-1][1] - self._commands[0][1]
        most = max(wrong or moved, key=abs)
        # One that was to stay, and turns, goes towards a command that is elsewhere.
        expected = turned if abs(turned) > _MOVED else start
        self._mirrored = abs(most) > _DEVIATION / 2 and most * expected < 0
        if not wrong:
            return None

        # A wrong sign, a wrong scale, or one side alone
        kind = "sign" if self._mirrored else "scale"
        if len(moved) > len(wrong) or min(wrong) < 0 < max(wrong):
            kind = "sides"
        instruction = f"by {turned:+.2f} rad" if abs(turned) > _MOVED else "to stay"
        measured = ", ".join(f"{m:+.2f}" for m in moved)
        text = f"the {self._name} flippers were told {instruction}, and turned by {measured} rad"
        return Fault(f"motion_{kind}", text, at_once=True, strike=True)

    def _leaves(self, now: float) -> Fault | None:
        """Compare the commands with a motion away from them, at a third of the flippers' speed."""
        # For as long as a decision, and no sooner after a hold than that counts as another fault
        begun, lasts = self._begun or 0.0, 2 * self._late
        if now - max(self._angles[0][0], begun + self._limits.recurs) < 0.8 * lasts:
            return None
        low = min(min(angle, target) for _, angle, target in self._commands)
        high = max(max(angle, target) for _, angle, target in self._commands)
        # How far off them it was, in five instants; a fall is over before the last
        last, count = len(self._angles) - 1, _INSTANTS - 1
        passed = [self._angles[last * i // count][1] for i in range(count + 1)]
        means = [sum(angles) / len(angles) for angles in passed]
        way = 1 if means[-1] > high else -1
        off = [max(way * angle - max(way * high, way * low), 0.0) for angle in means]
        steps = [after - before for before, after in itertools.pairwise(off)]
        if off[-1] <= self._limits.stall_error or min(steps) < self._speed * lasts / count / 3:
            return None
        text = f"turned by {means[-1] - means[0]:+.2f} rad, away from their commands"
        return self._held("motion_away", text)

    def _lags(self, now: float, target: float) -> Fault | None:
        """Compare what was commanded half a decision ago with how far the pair has come since."""
        angle = sum(self._angles[-1][1]) / len(self._angles[-1][1])
        # The command half a decision ago, and the turn that it belongs to
        past = [c for time, c, _ in self._commands if time <= now - self._late + 1e-9]
        recent = [c for time, c, _ in self._commands if time > now - self._late + 1e-9]
        command = self._commands[-1][1]
        way = math.copysign(1.0, target - command)
        if self._turn is None or (way != self._turn[0] and abs(target - command) > _MOVED):
            self._turn, self._judged = (way, command, angle), False
        way, begun, least = self._turn
        least = way * min(way * least, way * angle)  # it may first end the turn before
        self._turn = way, begun, least
        due = 0.0 if not past else way * (past[-1] - begun)
        come = way * (angle - least)
        # Once in a turn: has the pair made half of what it should have?
        if not self._judged and due >= _ENOUGH * self._step:
            self._judged = True
            self._slow = self._slow + 1 if _MOVED < come < due / 2 else 0
            self.obeys = self.obeys or come >= due / 2
            if self._slow > self.obeys:
                return self._held("motion_slow", f"turned by {come:.2f} of {due:.2f} rad in time")
        # A pair that is off its commands for long is blocked, if it does not even creep.
        reached, lasts = [*past[-1:], *recent, target], self._limits.stall_time
        off = _beyond(angle, min(reached), max(reached))
        if off <= self._limits.stall_error:
            self._missed = None
        elif self._missed is None:
            self._missed, self._from = now, angle
        elif now - self._missed >= lasts:
            if abs(angle - self._from) < _MOVED:
                return self._held("stall", "do not follow")
            text = f"were off their commands for {lasts:g} s, now by {off:.2f} rad"
            return self._held("motion_slow", text)
        return None

    def _held(self, name: str, what: str) -> Fault:
        self._missed, self._slow = None, 0
        hold = f"they are held for {self._limits.stall_hold:g} s, while the belts stand"
        load = name == "motion_away"  # as far as is known
        return Fault(name, f"the {self._name} flippers {what}; {hold}", gap=load, strike=not load)


def _beyond(angle: float, low: float, high: float) -> float:
    return max(low - angle, angle - high, 0.0)
