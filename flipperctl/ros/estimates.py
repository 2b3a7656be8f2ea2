"""Estimates of a robot's values from how it moved: plain statistics with intervals of 95 %.

In: angles of the flippers, pitch, way, belts and commands over time. Out: speed and delay of the
flippers, speed of the belts, torque of the flippers, friction; each with an interval, or the reason
why the motion does not tell it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Robot

Mask = NDArray[np.bool_]
GRAVITY = 9.81
_LEVEL = 0.05
"""Largest pitch of a robot on level ground [rad]."""
_TOUCHES = 0.015
"""Height above the ground up to which a round end may touch it [m]."""
_UNMODELLED = 0.03
"""Share of a torque that masses, lengths and inertia are wrong by [-]."""
_SLIPPERY = 1.5
"""Friction that no track exceeds, where a recording does not bound it [-]."""


@dataclass(frozen=True)
class Motion:
    """What a robot's devices measured, at the stamps of its joints."""

    time: FloatArray
    """(N,) [s]."""
    angles: FloatArray
    """(N, 2) angles of the front and the rear pair in frame R [rad]."""
    pitch: FloatArray
    """(N,) nose up positive; NaN where unknown, as in all that follows [rad]."""
    way: FloatArray
    """(N, 2) way of the chassis centre along its heading, and its height [m]."""
    belts: FloatArray
    """(N,) speed of the belts [m/s]."""
    commands: FloatArray
    """(M, 3) time [s] and target angles of both pairs in frame R [rad]."""

    def smooth(self) -> Motion:
        """Return the motion with angles and pitch averaged over 0.1 s."""
        width = 2 * round(0.05 / float(np.median(np.diff(self.time)))) + 1
        rows = np.column_stack([self.angles, self.pitch])
        padded = np.pad(rows, ((width // 2, width // 2), (0, 0)), "edge")
        means = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0).mean(axis=-1)
        return replace(self, angles=means[:, :2], pitch=means[:, 2])

    def targets(self) -> FloatArray:
        """Return the newest targets of both pairs at each time, NaN before the first, (N, 2)."""
        last = np.searchsorted(self.commands[:, 0], self.time, "right") - 1
        targets = np.full((len(self.time), 2), math.nan)
        targets[last >= 0] = self.commands[last[last >= 0], 1:]
        return targets


@dataclass(frozen=True)
class Estimate:
    """What a recording tells of a value."""

    low: float
    """Lower end of the interval; 0: the recording does not tell it."""
    high: float
    """Upper end, likewise infinite."""
    why: str
    """What told the value, or why nothing did and which drive would."""
    unit: str = "-"
    value: float | None = None
    """The likeliest value; None: the middle of the interval, if it has two ends."""

    @property
    def best(self) -> float | None:
        """The likeliest value; None if the interval has one end or none."""
        middle = 0.5 * (self.low + self.high) if self.low > 0 and self.high < math.inf else None
        return middle if self.value is None else self.value

    def near(self, value: float) -> float:
        """Return the likeliest value, or the end of the interval that is nearest to ``value``."""
        nearest = min(self.high, max(self.low, value))
        return nearest if self.best is None else self.best

    def interval(self) -> str:
        """Return the interval in words."""
        if self.high == math.inf:
            return f"at least {self.low:.4g}" if self.low > 0 else "not told"
        return f"{self.low:.4g} to {self.high:.4g}" if self.low > 0 else f"at most {self.high:.4g}"

    def to_dict(self) -> dict[str, Any]:
        """Return types of JSON; None for an infinite end."""
        row = asdict(self) | {"value": self.best, "interval": self.interval()}
        return row | {"high": None if self.high == math.inf else self.high}


class _Line(NamedTuple):
    """A straight stretch of a measurement."""

    first: float
    """Its begin [s]."""
    centre: tuple[float, float]
    """Mean time [s] and mean value."""
    slope: float
    error: float
    """Standard error of the slope."""
    spread: float
    """Standard error of the mean value."""


def _rates(time: FloatArray, values: FloatArray, window: float) -> FloatArray:
    """Return the mean slope around each time; NaN where the window passes an end or a pause."""
    before, after = time - window / 2, time + window / 2
    rates = (np.interp(after, time, values) - np.interp(before, time, values)) / window
    steps = np.diff(time, prepend=time[:1])
    paused = np.cumsum(steps > window)
    at = np.clip(np.searchsorted(time, [before, after]), 0, len(time) - 1)
    rates[(paused[at[0]] != paused[at[1]]) | (before < time[0]) | (after > time[-1])] = math.nan
    return np.asarray(rates)


def _runs(mask: Mask) -> Iterator[slice]:
    """Yield the stretches in which a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    yield from (slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True))


def _fit(time: FloatArray, values: FloatArray, degree: int = 1) -> tuple[FloatArray, FloatArray]:
    """Return coefficients by least squares, highest first, and their standard errors.

    Neighbouring residuals that are alike count as fewer measurements.
    """
    powers = np.vander(time - time.mean(), degree + 1)
    coefficients = np.asarray(np.linalg.lstsq(powers, values, rcond=None)[0], np.float64)
    rest = values - powers @ coefficients
    total = max(float(rest @ rest), 1e-18)
    alike = min(0.95, max(0.0, float(rest[1:] @ rest[:-1]) / total))
    variance: float = total / max(1, len(time) - degree - 1) * (1 + alike) / (1 - alike)
    return coefficients, np.sqrt(variance * np.diag(np.linalg.inv(powers.T @ powers)))


def _lines(motion: Motion, values: FloatArray, mask: Mask, window: float) -> list[_Line]:
    """Return the steady stretches of the fastest motion, without their begins and ends."""
    time = motion.time
    rates = np.where(mask, _rates(time, values, window), math.nan)
    speeds = np.abs(rates[np.isfinite(rates)])
    if not speeds.any():
        return []
    # Half of the usual speed of what moves; a short slip may be faster
    fast, lines = 0.5 * np.quantile(speeds[speeds > 0.1 * speeds.max()], 0.9), []
    for sign in (1, -1):
        for run in _runs(sign * rates > fast):
            inner = (time >= time[run][0] + window) & (time <= time[run][-1] - window)
            if inner.sum() >= 5 and np.ptp(time[inner]) >= window:
                (slope, mean), (error, spread) = _fit(time[inner], values[inner])
                centre = float(time[inner].mean()), float(mean)
                lines.append(_Line(time[run][0], centre, float(slope), error, spread))
    return lines


def _mean(values: Sequence[float], errors: Sequence[float]) -> tuple[float, float]:
    """Return the weighted mean and half of its interval, without outliers.

    The interval is that of the errors, widened by the scatter if that is larger (Birge's ratio).
    """
    x, e = np.array(values), np.maximum(errors, 1e-6)
    away = np.abs(x - np.median(x))
    near = away <= np.maximum(5 * e, 4 * np.median(away))
    x, weights = x[near], 1 / e[near] ** 2
    mean = float(np.average(x, weights=weights))
    ratio = float(weights @ (x - mean) ** 2) / max(1, len(x) - 1)
    return mean, 1.96 * math.sqrt(max(1.0, ratio) / weights.sum())


def _turns(motion: Motion) -> tuple[list[list[_Line]], int]:
    """Return the turns of each pair at the usual speed, and the number of all others.

    A pair that tilts the chassis carries it, and may be slower.
    """
    free = ~(np.abs(_rates(motion.time, motion.pitch, 0.3)) > 0.05)
    turns = [_lines(motion, motion.angles[:, pair], free, 0.15) for pair in (0, 1)]
    speeds = [abs(turn.slope) for pair in turns for turn in pair]
    usual = float(np.median(speeds)) if speeds else 0.0
    alike = [[t for t in pair if abs(abs(t.slope) / usual - 1) < 0.1] for pair in turns]
    return alike, len(speeds) - sum(map(len, alike))


def flipper_speed(motion: Motion) -> Estimate:
    """Return the turning rate of a pair [rad/s]: slopes of the angles while a pair turns."""
    pairs, others = _turns(motion)
    turns = [turn for pair in pairs for turn in pair]
    if not turns:
        return Estimate(0, math.inf, "no pair turned for 0.5 s; turn each up and down by 60°")
    mean, half = _mean([abs(t.slope) for t in turns], [t.error for t in turns])
    loaded = f"; {others} others were slower or faster, as under load" if others else ""
    return Estimate(mean - half, mean + half, f"turns: {len(turns)}{loaded}", value=mean)


def actuator_delay(motion: Motion) -> Estimate:
    """Return the time from a command to the turn [s]: where the turn's line leaves the rest."""
    delays: list[float] = []
    errors: list[float] = []
    for pair, lines in enumerate(_turns(motion)[0]):
        for at, sign in _commanded(motion.commands[:, 0], motion.commands[:, 1 + pair]):
            rest = (motion.time > at - 0.3) & (motion.time <= at)
            later = [line for line in lines if at - 0.1 < line.first < at + 1.5]
            still = rest.sum() > 2 and np.ptp(motion.angles[rest, pair]) < 0.05
            if still and later and later[0].slope * sign > 0:
                angles, line = motion.angles[rest, pair], later[0]
                spread = math.hypot(line.spread, angles.std() / math.sqrt(len(angles)))
                onset = line.centre[0] + (angles.mean() - line.centre[1]) / line.slope
                lever = (line.centre[0] - onset) * line.error
                delays.append(onset - at)
                errors.append(math.hypot(spread, lever) / abs(line.slope))
    if not delays:
        why = "has no command that a resting pair followed; record the commands of the flippers"
        return Estimate(0, math.inf, f"the bag {why}")
    mean, half = _mean(delays, errors)
    # Loops act at their ticks, as encoders do
    half += 0.5 * float(np.median(np.diff(motion.time)))
    why = f"commands: {len(delays)}"
    return Estimate(max(0.0, mean - half), mean + half, why, value=max(0.0, mean))


def _commanded(times: FloatArray, targets: FloatArray) -> Iterator[tuple[float, int]]:
    """Yield when a target begins to move after a rest of 0.3 s, and in which direction."""
    moved = np.flatnonzero(np.abs(np.diff(targets)) > 1e-3) + 1
    rested = np.diff(times[moved], prepend=times[:1]) >= 0.3
    for i in moved[rested].tolist():
        turn = targets[np.searchsorted(times, times[i] + 0.5) - 1] - targets[i - 1]
        if abs(turn) > 0.05:
            yield float(times[i]), int(math.copysign(1, turn))


def track_speed(motion: Motion) -> Estimate:
    """Return the speed of the belts [m/s]: of the chassis, driven steadily over level ground."""
    turning = np.abs([_rates(motion.time, angles, 0.3) for angles in motion.angles.T]).max(axis=0)
    level = (np.abs(motion.pitch) < _LEVEL) & ~(turning > 0.1)
    level &= ~(np.abs(_rates(motion.time, motion.way[:, 0], 0.4) - motion.belts) > 0.1)
    lines = _lines(motion, motion.way[:, 0], level, 0.4)
    if not lines:
        why = "no steady way over level ground with a pose; drive straight ahead for 3 s"
        return Estimate(0, math.inf, why)
    fastest = max(abs(line.slope) for line in lines)
    full = [line for line in lines if abs(line.slope) > 0.9 * fastest]
    mean, half = _mean([abs(line.slope) for line in full], [line.error for line in full])
    half += (1 - math.cos(_LEVEL)) * mean  # what a slope taken for level hides of the way
    why = f"stretches of level ground: {len(full)}"
    known = motion.belts[np.isfinite(motion.belts)]
    if not len(known) or np.ptp(known) < 0.1 * mean:
        why += "; no change of the belts' speed is known, so that they may do more"
    return Estimate(mean - half, mean + half, why, value=mean)


def friction(motion: Motion, tilt_error: float) -> Estimate:
    """Return the friction [-] by what slid and what was held on plane slopes.

    A robot that slides at the acceleration a on a slope s has tan s - a / (g cos s); where the
    chassis goes as the belts do, the friction is at least tan s. ``tilt_error`` of the pitch [rad].
    """
    motion, held = motion.smooth(), 0.0
    values: list[float] = []
    errors: list[float] = []
    for run, slope in _planes(motion):
        time, sign = motion.time[run], -math.copysign(1.0, slope)
        down = sign * (motion.way[run] @ _turned(slope)[:, 0])
        by_belts = sign * motion.belts[run] * np.diff(time, prepend=time[:1])
        slip = np.cumsum(np.diff(down, prepend=down[:1]) - by_belts)
        if np.ptp(slip) < 0.02 + 0.03 * np.ptp(down):
            held = max(held, math.tan(abs(slope) - tilt_error))
        rates = _rates(time, slip, 0.1)
        for slide in _runs(rates > 0.1):
            # From its begin to where it is fastest, or else slower and slower, to its end; without
            # the samples that made these be chosen
            since, end, peak = *time[slide][[0, -1]], time[slide][rates[slide].argmax()]
            until = peak if peak > 0.5 * (since + end) else end
            inner = (time > since + 0.1) & (time < until - 0.1) & (np.ptp(slip[slide]) > 0.1)
            if inner.sum() >= 6:
                angle = float(motion.pitch[run][inner].mean())
                fallen = sign * (motion.way[run][inner] @ _turned(angle)[:, 0])
                (half_of, *_), (error, *_) = _fit(time[inner], fallen, 2)
                scale, steep = 2 / (GRAVITY * math.cos(angle)), math.tan(abs(angle))
                values.append(steep - scale * float(half_of))
                by_tilt = tilt_error * (1 + values[-1] * steep)
                errors.append(math.hypot(scale * float(error), by_tilt))
    if values:
        mean, half = _mean(values, errors)
        low, why = max(held, mean - half), f"slides down a slope: {len(values)}"
        return Estimate(low, max(low, mean + half), why, value=max(low, mean))
    drive = "let it slide down a steep one, with its pose by other than the belts"
    if held:
        steep = math.degrees(math.atan(held))
        return Estimate(held, math.inf, f"never slid, held on a slope of {steep:.0f}°; {drive}")
    why = "no plane slope was driven while a device of their own told the belts' speed"
    return Estimate(0, math.inf, f"{why}; {drive}")


def _planes(motion: Motion) -> Iterator[tuple[slice, float]]:
    """Yield the stretches on a plane slope with raised flippers, and its inclination [rad].

    The chassis moved along its own axis there, as on no edge and in no hollow.
    """
    steady = np.abs(_rates(motion.time, motion.pitch, 0.2)) < 0.1
    raised = (motion.angles > -_LEVEL).all(axis=1) & (np.abs(motion.pitch) > 2 * _LEVEL)
    for run in _runs(steady & raised & np.isfinite(motion.way[:, 0]) & np.isfinite(motion.belts)):
        slope = float(np.median(motion.pitch[run]))
        same = np.abs(motion.pitch[run] - slope) < 0.03
        for part in _runs(same):
            inner = slice(run.start + part.start, run.start + part.stop)
            along, across = np.ptp(motion.way[inner] @ _turned(slope), axis=0)
            if along > 0.1 and across < 0.05 * along + 0.01:
                yield inner, float(motion.pitch[inner].mean())


def _turned(angle: float) -> FloatArray:
    """Return the matrix whose columns are the directions along and across a slope."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def flipper_torque(motion: Motion, robot: Robot, speed: float, rubbing: float) -> Estimate:
    """Return the torque of a pair [N m]: what it lifted, and what it could not, by statics.

    ``robot`` has masses and lengths, ``speed`` is the flippers' [rad/s], and ``rubbing`` the
    largest friction, which a lift has to overcome where tracks rub on the ground.
    """
    motion, rubbing = motion.smooth(), min(rubbing, _SLIPPERY)
    lows, highs = [0.0], [math.inf]
    targets = motion.targets()
    resting = np.abs(_rates(motion.time, motion.pitch, 0.5)) < 0.03
    standing = np.abs(_rates(motion.time, motion.way[:, 0], 0.3)) <= 0.05
    for pair in (0, 1):
        least, most, slack, lifted = _loads(motion, robot, pair, rubbing)
        # A turn against the load, in which friction hinders unless the other pair moves as well;
        # a rest on the load, and below one that does not move
        turning = _rates(motion.time, motion.angles[:, pair], 0.15) < -0.5 * speed
        still, other = (
            np.abs(_rates(motion.time, motion.angles[:, i], 0.5)) < 0.03 for i in (pair, 1 - pair)
        )
        still &= resting
        pushing = targets[:, pair] < motion.angles[:, pair] - 0.1
        rubs = np.where(standing & other, 0.0, slack)
        lows += _levels(motion.time, turning & lifted, least - rubs, 0.15, 0.9)
        lows += _levels(motion.time, still & lifted, least - slack, 0.5)
        highs += _levels(motion.time, still & pushing, most + slack, 1.0)
    low, high = max(lows) * (1 - _UNMODELLED), min(highs) * (1 + _UNMODELLED)
    light = "load the chassis (robot.payload) and lift again with both pairs"
    heavy = "press each pair down, the other one raised"
    if low > 0 and high < math.inf:
        return Estimate(min(low, high), max(low, high), "lifted one load, stalled below another")
    if low > 0:
        return Estimate(low, high, f"never stalled: lifted all loads; {light}")
    if high < math.inf:
        return Estimate(low, high, "stalled below all loads, lifted none")
    return Estimate(0, math.inf, f"never held a load on level ground; {heavy}")


def _levels(
    time: FloatArray, mask: Mask, values: FloatArray, lasting: float, share: float = 0.5
) -> list[float]:
    """Return the median, or another quantile, of each stretch of a mask that lasts so long [s]."""
    runs = (run for run in _runs(mask & np.isfinite(values)) if np.ptp(time[run]) >= lasting)
    return [float(np.quantile(values[run], share)) for run in runs]


def _loads(
    motion: Motion, robot: Robot, pair: int, rubbing: float
) -> tuple[FloatArray, FloatArray, FloatArray, Mask]:
    """Return the least and most torque that a pair needs to lift, the friction's part, [N m].

    NaN where the tip is not on level ground, or nothing behind it carries the other end. The mask
    tells where its own hinge is off the ground.
    """
    (front, rear), pitch = motion.angles.T, motion.pitch
    # Round ends and centres of mass in the level frame: rear tip, rear and front hinge, front tip
    hinge, axle = robot.hinge_offset, robot.flipper_axle
    along = np.array(
        [
            -hinge - axle * np.cos(rear),
            0 * rear - hinge,
            0 * rear + hinge,
            hinge + axle * np.cos(front),
        ]
    )
    above = np.array([axle * np.sin(rear), 0 * rear, 0 * rear, axle * np.sin(front)])
    x, z = (
        np.cos(pitch) * along - np.sin(pitch) * above,
        np.sin(pitch) * along + np.cos(pitch) * above,
    )
    gap = z - z.min(axis=0)
    touches = gap < _TOUCHES
    cx, cz = robot.centre_of_mass
    body = np.cos(pitch) * cx - np.sin(pitch) * cz
    flippers = 0.5 * (x[0] + x[1]), 0.5 * (x[3] + x[2])
    centre = (robot.carried_mass * body + robot.flipper_mass * sum(flippers)) / robot.mass
    # The load on the tip, for each end that may carry the other side
    tip, same, others = (3, 2, (1, 0)) if pair == 0 else (0, 1, (2, 3))
    weight = robot.mass * GRAVITY
    needs, rubs = [], []
    for other in others:
        load = weight * (centre - x[other]) / (x[tip] - x[other])
        possible = touches[tip] & touches[other] & (load > 0) & (load < weight)
        need = load * np.abs(x[tip] - x[same]) - robot.flipper_mass * GRAVITY * np.abs(
            flippers[1 - pair] - x[same]
        )
        needs.append(np.where(possible, need, math.nan))
        height = robot.track_radius + gap[same]
        rubs.append(np.where(possible, rubbing * np.minimum(load, weight - load) * height, 0.0))
    with np.errstate(invalid="ignore"):
        least, most = np.fmin(*needs), np.fmax(*needs)
    return least, most, np.maximum(*rubs), ~touches[same]


def estimates(motion: Motion, robot: Robot, tilt_error: float) -> dict[str, Estimate]:
    """Return what a motion tells of each value, by its key."""
    speed, slides = flipper_speed(motion), friction(motion, tilt_error)
    turning = speed.value or robot.flipper_speed
    torque = flipper_torque(motion, robot, turning, slides.high)
    return {
        "robot.flipper_speed": replace(speed, unit="rad/s"),
        "robot.actuator_delay": replace(actuator_delay(motion), unit="s"),
        "robot.track_speed": replace(track_speed(motion), unit="m/s"),
        "robot.flipper_torque": replace(torque, unit="N m"),
        "sim.friction": slides,
    }
