"""Points of a ``PointCloud2``, and when each of them was measured.

In: messages of one topic, of rclpy or of rosbags. Out: points, and the time of each after the stamp
[s]. Drivers write times in s, ms, µs or ns, from the beginning or the end of a turn or by a clock.
Unit and zero are found from the numbers, and times that fit none are reported and not used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flipperctl.core import FloatArray

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Datatype of a field → type of numpy."""
_NAMES = ("time", "t", "offset_time", "time_offset", "timestamp", "time_stamp", "ts")
"""Names of times; the first one that can be used counts, then others like them."""
_LIKE = ("time", "stamp")
_UNITS = (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9))
_LONGEST_TURN = 1.0
"""Longest turn, and largest time of a point before or after its stamp [s]."""
_ROUNDING = 1.05
"""Factor by which a turn may be longer; so exactly one unit makes a turn of a span."""
_BESIDE = 0.25
"""Time by which a turn may end before, or begin after, the stamp of its cloud [s]."""
_AGREED = 0.005
"""Time by which a cloud may be received before its last point was measured [s]."""
_SEVERAL = 10.0
"""Most turns for one period of the clouds, as of several LiDARs on one topic [-]."""
_OTHERS = 0.1
"""Largest share of points without a usable time, which are left out [-]."""
_SAMPLED = 50
"""Clouds from which unit and zero are found [-]."""
_TAIL = 2.0
"""Share of the times at either end that do not count for the length of a turn [%]."""


class Points(NamedTuple):
    """What a message holds."""

    points: FloatArray
    """(P, 3) points [m], without those that are not finite, or 0 as of rays without return."""
    times: dict[str, FloatArray]
    """Name of a field → (P,) its numbers."""


def read_cloud(message: Any) -> Points:
    """Return what a ``PointCloud2`` holds.

    Raises:
        ValueError: it has no coordinates, or its sizes contradict each other.
    """
    # Coordinates and times, as numpy reads them from the fields
    fields = {field.name: field for field in message.fields}
    for name in "xyz":
        if name not in fields or fields[name].datatype not in (7, 8):
            known = ", ".join(fields) or "none"
            raise ValueError(f"a cloud needs x, y and z as floats; fields: {known}")
    usable = [n for n, f in fields.items() if f.datatype in _NUMBERS and f.count == 1]
    names = [*"xyz", *sorted((n for n in usable if _is_time(n)), key=_preferred)]
    order, step = ">" if message.is_bigendian else "<", message.point_step
    kinds = [order + _NUMBERS[fields[name].datatype] for name in names]
    for name, kind in zip(names, kinds, strict=True):
        if fields[name].offset + np.dtype(kind).itemsize > step:
            raise ValueError(f"a cloud has points of {step} bytes, and {name} past their end")
    offsets = [fields[name].offset for name in names]
    layout = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": step})

    # Rows may be longer than their points.
    data, width = bytes(message.data), message.width * step
    if message.row_step < width or len(data) != message.height * message.row_step:
        raise ValueError(
            f"a cloud has {len(data)} bytes of data for {message.height} rows of "
            f"{message.width} points of {step} bytes, {message.row_step} bytes a row"
        )
    rows = np.frombuffer(data, np.uint8).reshape(message.height, message.row_step)

    # Rays without return are 0 or not finite.
    records = np.frombuffer(rows[:, :width].tobytes(), layout)
    points = np.column_stack([records[name].astype(np.float64) for name in "xyz"])
    valid = np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)
    return Points(
        points[valid], {name: records[name][valid].astype(np.float64) for name in names[3:]}
    )


def _is_time(name: str) -> bool:
    return name.lower() in _NAMES or any(part in name.lower() for part in _LIKE)


def _preferred(name: str) -> int:
    return _NAMES.index(name.lower()) if name.lower() in _NAMES else len(_NAMES)


class _Rule(NamedTuple):
    """How the numbers of a field become times after the stamp."""

    field: str
    unit: float
    """Of the numbers [s]."""
    absolute: bool
    """Whether they are of the clock of the stamps."""
    offset: float
    """Added to those after the stamp [s]."""


class PointTimes:
    """Unit and zero of the times of the points on one topic."""

    def __init__(self) -> None:
        self._seen: dict[str, list[tuple[float, ...]]] = {}
        self._clouds = 0
        self._rule: _Rule | None = None
        self._why = ""
        self._turn = 0.0
        self._unfit = 0

    @property
    def complete(self) -> bool:
        """Whether enough clouds were seen."""
        return self._clouds >= _SAMPLED

    def add(self, times: dict[str, FloatArray], stamp: float, received: float) -> None:
        """Learn from a cloud, unless enough were seen.

        ``received``: when it was received, by the clock of the stamps [s]; NaN if unknown.
        """
        if self.complete:
            return
        self._clouds += 1
        for name, values in times.items():
            known = values[np.isfinite(values)]
            if len(known):
                low, high = np.percentile(known, [_TAIL, 100 - _TAIL])
                cloud = stamp, received, known.min(), known.max(), high - low
                self._seen.setdefault(name, []).append(cloud)
        # The first field whose times make sense counts.
        self._rule, why = None, []
        for name in sorted(self._seen, key=_preferred):
            rule, reason = _fitting(name, np.array(self._seen[name]).T)
            self._rule = self._rule or rule
            why += [reason] if reason else []
        self._why = "" if self._rule is not None and self._rule.offset == 0 else "; ".join(why)

    def shifts(self, times: dict[str, FloatArray], stamp: float) -> FloatArray | None:
        """Return the time of each point after the stamp, (P,) [s]; NaN without one.

        None: the times tell nothing, and all points count as measured at the stamp.
        """
        rule = self._rule
        if rule is None or not len(values := times.get(rule.field, ())):
            return None
        zero = stamp if rule.absolute else 0.0
        shifts = np.asarray(values) * rule.unit - zero + rule.offset
        shifts[~(np.abs(shifts) <= _LONGEST_TURN * _ROUNDING)] = np.nan
        if np.isnan(shifts).mean() > _OTHERS:
            self._unfit += 1
            return None
        return shifts

    def remarks(self) -> list[str]:
        """Return what a reader of the result should know of the times."""
        texts = [self._why] if self._why else []
        if self._unfit and self._rule is not None:
            texts.append(
                f"the times of the points ({self._rule.field}) of {self._unfit} clouds lie more "
                f"than {_LONGEST_TURN:g} s from the stamp, or are no numbers: the robot's motion "
                "within these turns is not taken out"
            )
        return texts


def _fitting(name: str, clouds: FloatArray) -> tuple[_Rule | None, str]:
    """Return the rule of a field, if one fits, and what to remark on it.

    ``clouds``: (5, C) stamp, time of receipt, least and largest time, and span without odd ones.
    """
    stamp, received, begin, end, span = clouds
    # The length of a turn, in the field's own unit
    turn = float(np.median(span)) / (1 - 2 * _TAIL / 100)
    least, most = float(np.median(begin)), float(np.median(end))
    where = f"the times of the points ({name}, as {least:.10g} to {most:.10g})"
    lost = "the robot's motion within a turn is not taken out"
    if turn == 0:
        unset = least == most == 0  # as of a driver that takes the motion out itself
        return None, "" if unset else f"{where} are the same for all points of a cloud: {lost}"

    # The largest unit in which a turn is not too long; the period of the clouds must agree.
    units = [pair for pair in _UNITS if turn * pair[1] <= _LONGEST_TURN * _ROUNDING]
    if not units or turn * units[0][1] < _LONGEST_TURN * _ROUNDING / 1000:
        return None, f"{where} make no turn of {_LONGEST_TURN:g} s or less in any unit: {lost}"
    symbol, unit = units[0]
    stamps = np.unique(stamp)
    if len(stamps) > 1:
        period = float(np.median(np.diff(stamps)))
        longer = 1000 * turn * unit
        if turn * unit > _SEVERAL * period or 0.5 < longer / period < 1.5:
            return None, (
                f"{where} make a turn of {turn * unit:.3g} s in {symbol}, or of "
                f"{longer:.3g} s, and clouds come every {period:.3g} s: {lost}"
            )
    begin, end = begin * unit, end * unit

    def fit(absolute: bool) -> tuple[float, float]:
        """Return the share of clouds whose turn is beside the stamp, and how steadily it is."""
        zero, farthest = (stamp, _LONGEST_TURN) if absolute else (0.0, _BESIDE)
        near = (begin - zero <= farthest) & (end - zero >= -farthest)
        return float(near.mean()), -float(np.std(end - zero))

    # Times count from the stamp, or by its clock, whichever has more turns beside the stamp.
    (share, _), relative = max((fit(absolute), not absolute) for absolute in (False, True))
    if share <= 0.5:
        return None, f"{where} are neither relative to the stamp nor of its clock: {lost}"
    rule = _Rule(name, unit, not relative, 0.0)
    late = received - stamp  # [s]; comparisons with NaN are false
    counts = relative and np.median(begin) >= -0.1 * np.median(end)
    # No cloud is received before its last point was measured.
    if not (counts and np.median(late - end) < -_AGREED <= np.median(late)):
        return rule, ""
    return rule._replace(offset=-float(np.median(end))), (
        f"{where} count from the beginning of a turn, and the clouds were received too early for "
        "one that begins at the stamp: the stamp is taken for its end"
    )
