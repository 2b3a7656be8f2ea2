"""Cross-checks: one quantity by two independent measurements, and how far these may differ.

In: plain arrays of times and values, of a recording or of what a controller received. Out: the
largest difference of each pair; ``CHECKS`` says what is allowed, and what a larger one means.
Motion counts that one of the two measurements tells: one that tells none, as planar poses or a
still robot, contradicts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from flipperctl.core import FloatArray


@dataclass(frozen=True)
class Check:
    """A quantity that two sources measure."""

    name: str
    """Stable name; its part before ``_`` is what is not used, or what ends the work, if refused."""
    quantity: str
    first: str
    second: str
    unit: str
    warn: float
    """Largest difference without a remark."""
    refuse: float
    """Largest difference with which the source is used; infinite: any."""
    means: str
    """The likely causes of a larger one."""


CHECKS = (
    Check("attitude_absent", "share without", "attitude", "messages", "1", 0.0, 0.99,
          "a unit that tells no orientation (its covariance or quaternion says so), to which a "
          "filter such as imu_filter_madgwick adds an orientation, or one that sent nothing"),
    Check("attitude_poses", "change of tilt", "attitude", "recorded poses", "rad", 0.08, 0.14,
          "an orientation that is never set, frozen or a heading alone, NED or another sign, or a "
          "mounting that is not in tf"),
    Check("attitude_vertical", "vertical", "attitude", "fixed frame", "rad", 0.17, 1.0,
          "z down (NED), a mounting that is not in tf, or a fixed frame that began tilted"),
    Check("attitude_gravity", "vertical", "attitude", "accelerations", "rad", 0.1, 0.26,
          "an orientation that is never set, frozen or a heading alone, NED, or accelerations of "
          "another sign"),
    Check("attitude_rates", "change of tilt", "attitude", "turn rates", "rad", 0.08, 0.15,
          "an orientation that is never set, frozen or a heading alone, another sign, or rates in "
          "degrees"),
    Check("attitude_return", "jump to and fro", "attitude", "attitude before", "rad", 0.05, 0.1,
          "an orientation that is filled in now and then, or two units on one topic"),
    Check("belts_short", "way ahead, less", "belts", "recorded poses", "1", 0.25, 0.45,
          "a speed that is not filled in, along the axes of the world, of another sign or unit, or "
          "of fused odometry"),
    Check("belts_long", "way ahead, more", "belts", "recorded poses", "1", 1.0, 4.0,
          "another unit such as mm/s, or belts that slip"),
    Check("joints_pair", "angle", "left joint", "right joint", "rad", 0.15, 0.5,
          "joints that count in opposite ways, one that stands still, one in degrees, or flippers "
          "that are turned apart"),
    Check("stamps_back", "step back", "stamps", "their order", "s", 0.1, 1.0,
          "a clock that was set back, or two recordings in one"),
    Check("stamps_clock", "change of delay", "stamps", "recording's clock", "s", 0.5, math.inf,
          "a clock that was set, or one that runs at another speed, as a simulator's"),
    Check("stamps_others", "delay", "stamps", "those of the others", "s", 0.5, 2.0,
          "another clock, or another unit of time"),
    Check("stamps_equal", "share of equal ones", "stamps", "stamp before", "1", 0.1, math.inf,
          "a stamp that stands still, or two devices on one topic"),
    Check("transforms_static", "fixed transform", "value", "other values", "m", 0.005, 0.05,
          "two publishers of one transform"),
    Check("transforms_return", "jump to and fro", "pose", "pose before", "m", 0.05, 0.1,
          "two publishers of one transform"),
    Check("transforms_jump", "jump", "pose", "pose before", "m", 0.1, math.inf,
          "a correction of the map, or a robot that was carried"),
    Check("cloud_repeats", "way since the points", "cloud", "cloud before", "m", 0.05, math.inf,
          "a driver that repeats its last cloud, which is not used again"),
    Check("heights_rounding", "step of heights", "heights", "their format", "m", 0.01, math.inf,
          "whole numbers, half precision, or single precision far from 0"),
)  # fmt: skip
"""What is compared; a length of 1 m turned by an angle [rad] counts as its way [m]."""
_BY_NAME = {check.name: check for check in CHECKS}


class Peak(NamedTuple):
    """The largest difference of two measurements."""

    size: float
    time: float = math.nan
    """When it was [s]; NaN if it is no instant."""


class Difference(NamedTuple):
    """How far two measurements of a source differ."""

    check: Check
    source: str
    """Topic, joints or frames."""
    peak: Peak

    @property
    def verdict(self) -> str:
        """``ok``, ``warned`` or ``refused``."""
        size, check = self.peak.size, self.check
        return "ok" if size <= check.warn else "warned" if size <= check.refuse else "refused"

    def sentence(self, begun: float = 0.0) -> str:
        """Return what differs, by how much and why; ``begun``: from which times count [s]."""
        check, (size, time) = self.check, self.peak
        at = "" if math.isnan(time) else f" at {time - begun:.1f} s"
        unit = "" if check.unit == "1" else f" {check.unit}"
        return (
            f"{self.source}: {check.quantity}, {check.first} against {check.second}: "
            f"{size:.4g}{unit}{at}, {check.warn:g}{unit} is allowed; likely: {check.means}"
        )

    def row(self, begun: float = 0.0) -> dict[str, Any]:
        """Return the row of a table."""
        check, (size, time) = self.check, self.peak
        return {
            "check": check.name,
            "quantity": check.quantity,
            "first": check.first,
            "second": check.second,
            "source": self.source,
            "difference": round(float(size), 4),
            "unit": check.unit,
            "warn": check.warn,
            "refuse": None if math.isinf(check.refuse) else check.refuse,
            "seconds": None if math.isnan(time) else round(time - begun, 3),
            "verdict": self.verdict,
        }


def compared(source: str, **peaks: Peak | None) -> list[Difference]:
    """Return the differences of a source, by the names of their checks; None was not compared."""
    return [Difference(_BY_NAME[name], source, p) for name, p in peaks.items() if p is not None]


def largest(differences: Iterable[Difference]) -> list[Difference]:
    """Return the largest difference of each check, in the order of the list."""
    ranked = sorted(differences, key=lambda difference: difference.peak.size)
    last = {difference.check.name: difference for difference in ranked}
    return [last[check.name] for check in CHECKS if check.name in last]


def exceeds(name: str, size: float) -> str:
    """Return why a difference is refused, for a controller; empty if it is not."""
    check = _BY_NAME[name]
    if size <= check.refuse:
        return ""
    return (
        f"{check.quantity}, {check.first} against {check.second}: {size:.2f} {check.unit}; "
        f"{check.refuse:g} is allowed; likely: {check.means}"
    )


# Tilt ---------------------------------------------------------------------------------------------

_SMOOTHED = 5
"""Samples whose median counts, so that single ones do not [-]."""
_GRAVITY = 9.81
_NEAR_GRAVITY = 0.7, 1.27
"""Magnitudes, per gravity, of an acceleration that is taken for gravity [-]."""
_MEMORY = 3.0
"""Time over which turn rates count; the error of a gyroscope does not add up [s]."""
_AVERAGED = 0.5
"""Time over which accelerations are averaged [s]."""
_NONE = 0.0, 0.0, 0.0
_LONGEST_STEP = 1.0
"""Longest time between two attitudes whose change is compared with the rates [s]."""


def angles(vectors: FloatArray, others: ArrayLike) -> FloatArray:
    """Return the angles between vectors, (N, 3), and others, (N, 3) or (3,), (N,) [rad]."""
    others = np.broadcast_to(np.asarray(others, dtype=np.float64), vectors.shape)
    crossed = np.linalg.norm(np.cross(vectors, others), axis=1)
    angle: FloatArray = np.arctan2(crossed, (vectors * others).sum(axis=1))
    return angle


def _peak(times: FloatArray, sizes: FloatArray) -> Peak | None:
    """Return the largest running median of sizes, (N,); None without any."""
    known = np.isfinite(sizes)
    times, sizes = times[known], sizes[known]
    if not len(sizes):
        return None
    # A single odd sample decides nothing.
    width = min(_SMOOTHED, len(sizes))
    medians = np.median(sliding_window_view(sizes, width), axis=1)
    at = int(np.argmax(medians))
    return Peak(float(medians[at]), float(times[at + width // 2]))


def by_poses(times: FloatArray, ups: FloatArray, turns: FloatArray) -> dict[str, Peak | None]:
    """Compare attitudes with recorded poses at the same times, (N,) [s].

    ``ups``: the vertical in the chassis by the attitude, (N, 3); ``turns``: the chassis in the
    fixed frame, (N, 3, 3). In that frame the vertical must not move while the poses tilt.
    """
    known = np.isfinite(ups).all(axis=1)
    times, ups, turns = times[known], ups[known], turns[known]
    if not len(times):
        return {}
    # How far the vertical moves in the fixed frame, but no farther than the poses tilt
    vertical, tilts = np.einsum("nij,nj->ni", turns, ups), turns[:, 2]
    swings = angles(vertical, np.median(vertical, axis=0))
    tilted = angles(tilts, np.median(tilts, axis=0))
    lean = float(np.median(angles(vertical, (0.0, 0.0, 1.0))))
    change = _peak(times, np.minimum(swings, tilted))
    return {"attitude_poses": change, "attitude_vertical": Peak(lean)}


def by_gravity(times: FloatArray, ups: FloatArray, accelerations: FloatArray) -> Peak | None:
    """Compare the vertical of attitudes, (N, 3), with accelerations, (N, 3), of the same frame.

    These are the means of parts of a recording; those that gravity does not rule are left out.
    """
    size = np.linalg.norm(accelerations, axis=1)
    least, most = _NEAR_GRAVITY
    rules = [(size > least * unit) & (size < most * unit) for unit in (_GRAVITY, 1.0)]  # or in g
    known = np.isfinite(ups).all(axis=1) & (rules[0] | rules[1])
    return _peak(times[known], angles(ups[known], accelerations[known]))


class Tilts:
    """Compares attitudes with turn rates and accelerations, message by message."""

    def __init__(self) -> None:
        self._last: tuple[float, Sequence[float]] | None = None
        # Of the vertical, as far as remembered [rad]; and the means of a short time.
        self._turned = self._tilted = self._up = self._push = _NONE
        self._since = math.inf

    def add(
        self,
        time: float,
        up: Sequence[float],
        rates: Sequence[float],
        acceleration: Sequence[float] | None = None,
    ) -> dict[str, float]:
        """Return how far the tilt of the last seconds differs from that by the rates [rad].

        ``up``: the vertical in the frame of the unit, (3,); ``rates``: of that frame about its
        axes, (3,) [rad/s]; ``acceleration``: along these, (3,). By name of the check. The first is
        no more than the rates tell: rates of 0 tell nothing.
        """
        last, self._last = self._last, (time, up)
        if last is None or not 0 < (elapsed := time - last[0]) < _LONGEST_STEP:
            self._turned = self._tilted = self._up = self._push = _NONE
            self._since = time
            return {}

        # The vertical turned by the rates, and the vertical of the attitudes, since the last
        # message
        (x, y, z), (p, q, r) = last[1], rates
        turned = elapsed * (y * r - z * q), elapsed * (z * p - x * r), elapsed * (x * q - y * p)
        tilted = [a - b for a, b in zip(up, last[1], strict=True)]
        differences = {}
        if all(map(math.isfinite, (*turned, *tilted))):
            fading = math.exp(-elapsed / _MEMORY)
            self._turned = _faded(fading, self._turned, turned)
            self._tilted = _faded(fading, self._tilted, tilted)
            apart = math.dist(self._turned, self._tilted)
            differences["attitude_rates"] = min(apart, math.hypot(*self._turned))

        # Both averaged alike, so that the same instants count in the two means
        if acceleration is not None and all(map(math.isfinite, (*up, *acceleration))):
            fading = math.exp(-elapsed / _AVERAGED)
            self._up = _faded(fading, self._up, (elapsed * value for value in up))
            self._push = _faded(fading, self._push, (elapsed * value for value in acceleration))
            scale = math.hypot(*self._up) / math.hypot(*up)
            if time - self._since > 2 * _AVERAGED and scale > 0:
                mean = np.array([self._push]) / scale
                peak = by_gravity(np.array([time]), np.array([self._up]), mean)
                differences["attitude_gravity"] = peak.size if peak else 0.0
        return differences


def _faded(
    fading: float, total: Iterable[float], more: Iterable[float]
) -> tuple[float, float, float]:
    x, y, z = (fading * (a + b) for a, b in zip(total, more, strict=True))
    return x, y, z


# Belts --------------------------------------------------------------------------------------------

_SEGMENT = 0.15
"""Way of the poses over which the belts are compared, longer than noise [m]."""
_ALONG = 0.7
"""Least share of a segment that is along the chassis; the rest turns or slides [-]."""


def by_way(
    times: FloatArray, speeds: FloatArray, posed: FloatArray, places: FloatArray, ahead: FloatArray
) -> dict[str, Peak | None]:
    """Compare the way by speeds of the belts, (S,) [m/s] at times (S,) [s], with the way of poses.

    ``posed``, (N,) [s]: times of the poses; ``places``, (N, 3) [m]; ``ahead``: x of the chassis.
    """
    speeds = np.where(np.isfinite(speeds), speeds, 0.0)
    driven = np.append(0.0, np.cumsum(speeds[:-1] * np.maximum(np.diff(times), 0.0)))
    ways = np.interp(posed, times, driven)
    # Segments of the way, each longer than the noise of the poses
    ratios, start = [], 0
    for i in range(1, len(posed)):
        step = places[i] - places[start]
        if (far := float(np.linalg.norm(step))) < _SEGMENT:
            continue
        along = float(step @ (ahead[i] + ahead[start])) / 2
        if abs(along) >= _ALONG * far:
            ratios.append((ways[i] - ways[start]) / along)
        start = i
    if not ratios:
        return {}
    short = float(np.mean(1 - np.clip(ratios, -1.0, 1.0)))
    return {"belts_short": Peak(short), "belts_long": Peak(float(np.median(ratios)) - 1)}


# Stamps and transforms ----------------------------------------------------------------------------

_WINDOW = 2.0
"""Time whose shortest delay counts, so that stalls of a network do not [s]."""
_SLOW, _FASTER = 1.0, 3.0
"""Speed that is no jump of a frame [m/s], and how much faster than before and after a jump is [-].
"""
_INSTANT = 1e-3
"""Shortest time for which a speed is computed [s]."""
_FEWEST_RETURNS = 3
"""Jumps to and fro that single wrong poses do not make [-]."""


def by_clock(received: FloatArray, stamps: FloatArray) -> tuple[dict[str, Peak | None], float]:
    """Compare stamps, (N,) [s], in the order of their receipt, with its times, (N,) [s].

    Also returns by how much messages are received after their stamps, without stalls [s].
    """
    steps = np.diff(stamps)
    if not len(steps):
        return {}, float((received - stamps)[0]) if len(stamps) else 0.0
    # The worst step back, and the delay of each window without its stalls
    back = int(np.argmin(steps))
    begins = np.flatnonzero(np.diff(np.floor((received - received[0]) / _WINDOW), prepend=-1.0))
    delays = np.minimum.reduceat(received - stamps, begins)
    changes = np.abs(delays - delays[0])
    at = int(np.argmax(changes))
    peaks: dict[str, Peak | None] = {
        "stamps_back": Peak(max(0.0, -float(steps[back])), float(stamps[back])),
        "stamps_clock": Peak(float(np.ptp(delays)), float(stamps[begins[at]])),
        "stamps_equal": Peak(float(np.mean(steps == 0))),
    }
    return peaks, float(np.median(delays))


def by_steps(times: FloatArray, places: FloatArray, turns: FloatArray) -> dict[str, Peak | None]:
    """Compare each pose of a link, at times (N,) [s], with the poses before and after it.

    ``places``: (N, 3) [m]; ``turns``: unit quaternions, (N, 4). A jump is far faster than what was
    before and after it; one that the next step takes back is of two publishers.
    """
    if len(times) < 2:
        return {}
    # In the order of their times, whatever the order of receipt
    order = np.argsort(times, kind="stable")
    times, places, turns = times[order], places[order], turns[order]
    steps, elapsed = _apart(places, turns, 1), np.diff(times)
    returns = np.zeros_like(steps)
    if len(times) > 2:
        # In the shorter of both steps: two publishers may be slow, and close to each other.
        both, shorter = (np.minimum(values[1:], values[:-1]) for values in (steps, elapsed))
        both = np.maximum(0.0, both - _SLOW * shorter)
        returns[1:] = np.where(_apart(places, turns, 2) < 0.5 * both, both, 0.0)

    # A jump is sudden beside the speeds around it, and stays.
    speeds = np.pad(steps / np.maximum(elapsed, _INSTANT), 1)
    around = np.maximum(speeds[:-2], speeds[2:])  # of the steps before and after each
    sudden = steps > 2 * np.maximum(_SLOW, _FASTER * around) * elapsed
    back = (returns > 0) | (np.append(returns[1:], 0.0) > 0)
    jumps = np.where(sudden & ~back, steps, 0.0)

    # A few returns may be single wrong poses.
    many = np.argsort(returns)[-min(_FEWEST_RETURNS, len(returns))]
    last = int(np.argmax(jumps))
    return {
        "transforms_return": Peak(float(returns[many]), float(times[many])),
        "transforms_jump": Peak(float(jumps[last]), float(times[last + 1])),
    }


def _apart(places: FloatArray, turns: FloatArray, steps: int) -> FloatArray:
    """Return by how much poses differ from those ``steps`` earlier, (N - steps,) [m]."""
    far = np.linalg.norm(places[steps:] - places[:-steps], axis=1)
    same = np.abs((turns[steps:] * turns[:-steps]).sum(axis=1))
    largest: FloatArray = np.maximum(far, 2 * np.arccos(np.minimum(1.0, same)))
    return largest


def repeats(contents: Sequence[int], moved: FloatArray) -> tuple[NDArray[np.bool_], Peak]:
    """Find messages that tell nothing new: content as before, although the robot has moved.

    ``contents``: digests, (N,); ``moved``: the way until each message, (N,) [m]. Returns which
    these are, (N,), and how far the robot moved while a content stayed.
    """
    # How far the robot has moved since the content began
    values = np.asarray(contents)
    begins = np.append(True, values[1:] != values[:-1])
    first = np.maximum.accumulate(np.where(begins, np.arange(len(values)), 0))
    since = moved - moved[first]
    return since > _BY_NAME["cloud_repeats"].warn, Peak(float(since.max()))


# Heights ------------------------------------------------------------------------------------------


def rounding(values: FloatArray, *, whole: bool = False) -> float:
    """Return the step to which a format rounds finite values, (N,); 0: none does.

    Formats are half and single precision and, with ``whole``, whole numbers: one that holds all
    values without loss, and whose step two of them differ by.
    """
    values = np.unique(values)
    if len(values) < 2:
        return 0.0
    # A format rounds if it holds all values, and its step is one by which two of them differ.
    least, largest, steps = np.diff(values).min(), np.abs(values).max(), [0.0]
    if whole and len(values) > 2 and (values == np.round(values)).all():
        steps.append(1.0)
    with np.errstate(over="ignore"):
        for kind in (np.float16, np.float32):
            short = values.astype(kind)
            if (short == values).all():
                steps.append(float(np.spacing(kind(largest))))
    return max(step for step in steps if step == 0 or least <= step)
