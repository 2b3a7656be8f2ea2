"""Random clouds of LiDARs, with invalid points and times: few points are lost, or it is told."""

from types import SimpleNamespace

import numpy as np

from flipperctl.runtime.point_cloud import PointTimes, read_cloud

_CODES = {"u4": 6, "i4": 5, "f4": 7, "f8": 8}
_UNITS = (1.0, 1e3, 1e6, 1e9)


def check(seed):
    """Check one recording of some clouds; its points have times of a random unit and zero.

    Raises:
        AssertionError: points are lost without a remark, or their times are wrong.
    """
    rng = np.random.default_rng(seed)
    period = rng.uniform(0.05, 0.2)
    unit = _UNITS[rng.integers(4)]
    zero = ("begin", "end", "stamp", "boot")[rng.integers(4)]
    codes = ["f8"] if zero in ("stamp", "boot") else ["f8", "f4", "u4" if zero == "begin" else "i4"]
    code = codes[rng.integers(len(codes))]
    name = ("time", "t", "timestamp", "offset_time", "time_stamp")[rng.integers(5)]
    if code in ("u4", "i4") and unit < 1e6:
        unit = 1e9
    invalid = rng.choice([0.0, 0.05, 0.6])
    begun, boot = 1.7e9 + rng.uniform(0, 1e6), rng.uniform(100, 1e6)
    times, clouds = PointTimes(), []
    for number in range(8):
        count = int(rng.integers(50, 400))
        true = np.sort(rng.uniform(-period, 0, count))  # after the end of the turn
        true[[0, -1]] = -period, 0
        end = begun + number * period
        stamp = end - period if zero == "begin" else end
        numbers = {"begin": true + period, "end": true, "stamp": true + end}.get(zero, true + boot)
        rows = np.zeros(count, [*((axis, "<f4") for axis in "xyz"), (name, f"<{code}")])
        for axis in "xyz":
            rows[axis] = rng.normal(size=count)
        lost = rng.random(count) < invalid
        rows["x"][lost] = np.nan
        rows[name] = numbers * unit
        if code[0] == "f":
            rows[name][lost] = rng.choice([0.0, np.nan, 1e30])
        if zero == "boot":
            boot += period
        step = rows.itemsize
        fields = [
            SimpleNamespace(name=n, offset=at, count=1, datatype=_CODES[kind.str[1:]])
            for n, (kind, at) in rows.dtype.fields.items()
        ]
        message = SimpleNamespace(
            **{"fields": fields, "height": 1, "width": count, "is_bigendian": False},
            **{"point_step": step, "row_step": step * count, "data": rows.tobytes()},
        )
        found = read_cloud(message)
        assert len(found.points) == count - lost.sum()
        times.add(found.times, stamp, end + 0.01)
        clouds.append((found, stamp, true[~lost] + end))
    for found, stamp, true in clouds:
        shifts = times.shifts(found.times, stamp)
        if shifts is None:
            assert times.remarks() or zero == "boot", (seed, zero, name, code, unit)
            continue
        assert zero != "boot", (seed, zero, name, code, unit)
        # Integers of µs are exact to that; double precision of a date to 0.2 µs.
        assert np.abs(shifts + stamp - true).max() < 1e-4, (seed, zero, name, code, unit)
    if zero == "boot":
        assert times.remarks(), (seed, zero, name, code, unit)
