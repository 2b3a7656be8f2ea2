"""Points of a ``PointCloud2``, and their times in the units and of the zeros of drivers."""

from types import SimpleNamespace

import numpy as np
import pytest

from flipperctl.runtime.point_cloud import PointTimes, read_cloud

STAMP = 1.7e9
CODES = {"i4": 5, "u4": 6, "f4": 7, "f8": 8}
TURN = np.linspace(-0.1, 0, 201)


def cloud(points, name, times, code):
    rows = np.zeros(len(points), [*((axis, "<f4") for axis in "xyz"), (name, f"<{code}")])
    rows["x"], rows["y"], rows["z"] = np.asarray(points).T
    rows[name] = times
    fields = [
        SimpleNamespace(name=n, offset=at, count=1, datatype=CODES[kind.str[1:]])
        for n, (kind, at) in rows.dtype.fields.items()
    ]
    step = rows.itemsize
    return SimpleNamespace(
        **{"fields": fields, "height": 1, "width": len(rows), "is_bigendian": False},
        **{"point_step": step, "row_step": step * len(rows), "data": rows.tobytes()},
    )


def told(name, code, numbers, turns=5, period=0.1, late=0.01, turn=TURN):
    """The shifts of the last of some clouds, and the remarks."""
    times, points = PointTimes(), np.ones((len(turn), 3))
    for number in range(turns):
        stamp = STAMP + number * period
        read = read_cloud(cloud(points, name, numbers(turn, stamp), code)).times
        times.add(read, stamp, stamp + late)
    return times.shifts(read, stamp), times.remarks()


@pytest.mark.parametrize(
    ("name", "code", "numbers", "begin"),
    [
        ("time", "i4", lambda t, s: t * 1e9, -0.1),
        ("time", "f4", lambda t, s: t + 0.05, -0.05),  # of a stamp in the middle
        ("timestamp", "f8", lambda t, s: t + s, -0.1),
        ("time_stamp", "f8", lambda t, s: (t + s) * 1e6, -0.1),
        ("timestamp", "f8", lambda t, s: (t + s) * 1e9, -0.1),
        ("offset_time", "f8", lambda t, s: t + s - 0.4, -0.5),  # stamped when it arrived
    ],
)
def test_unit_and_zero_are_found_from_the_numbers(name, code, numbers, begin):
    shifts, remarks = told(name, code, numbers)
    assert remarks == []
    assert [shifts[0], shifts[-1]] == pytest.approx([begin, begin + 0.1], abs=1e-6)


@pytest.mark.parametrize("turn", [0.02, 0.1, 1.0])
def test_turns_of_any_length_in_any_unit(turn):
    times = np.linspace(-turn, 0, 201)
    for unit in (1, 1e3, 1e6, 1e9):
        shifts, _ = told("time", "f8", lambda t, s, u=unit: t * u, period=turn, turn=times)
        assert shifts == pytest.approx(times, abs=1e-9)


def test_times_since_the_beginning_end_at_the_stamp_if_it_came_too_early():
    """No cloud is received before its last point was measured."""

    def since(turn, stamp):
        return (turn + 0.1) * 1e9

    shifts, remarks = told("t", "u4", since, late=0.12)
    assert ([shifts[0], shifts[-1]], remarks) == (pytest.approx([0, 0.1]), [])
    shifts, (remark,) = told("t", "u4", since, late=0.0)
    assert [shifts[0], shifts[-1]] == pytest.approx([-0.1, 0])
    assert "(t, as 0 to 100000000) count from the beginning of a turn" in remark


@pytest.mark.parametrize(
    ("numbers", "remark"),
    [
        (lambda t, s: t * 0, None),
        (lambda t, s: t * 0 + s, "are the same for all points of a cloud"),
        (lambda t, s: t * 50, "make a turn of 0.005 s in ms, or of 5 s"),
        (lambda t, s: t + 37 + s, "are neither relative to the stamp nor of its clock"),
        (lambda t, s: (t + s) % 3600 * 1e6, "are neither relative"),  # since the full hour
        (lambda t, s: np.where(t < -0.05, np.nan, t), "are no numbers"),
    ],
)
def test_times_that_fit_nothing_are_told_and_not_used(numbers, remark):
    shifts, remarks = told("time", "f8", numbers, period=5.0)
    assert shifts is None
    assert [remark in one for one in remarks] == [True] * (remark is not None)


def test_a_few_points_without_a_time_are_left_out():
    shifts, remarks = told("time", "f4", lambda t, s: np.where(t < -0.095, np.nan, t))
    assert (np.isnan(shifts).sum(), remarks) == (10, [])


def test_rays_without_return_do_not_count():
    points = np.ones((3, 3))
    points[0], points[1, 2] = 0, np.nan
    found = read_cloud(cloud(points, "time", [5, 6, 7], "f4"))
    assert (found.points.tolist(), found.times["time"].tolist()) == ([[1, 1, 1]], [7])


def test_the_padding_of_rows_is_no_points():
    rows = np.zeros((2, 16), "<f4")  # of three points each, and 16 bytes behind them
    rows[:, :12] = np.arange(1, 25).reshape(2, 12)
    fields = [
        SimpleNamespace(name=n, offset=4 * i, count=1, datatype=7) for i, n in enumerate("xyz")
    ]
    message = SimpleNamespace(fields=fields, is_bigendian=False, point_step=16, row_step=64)
    message.width, message.height, message.data = 3, 2, rows.tobytes()
    assert read_cloud(message).points.tolist() == np.arange(1.0, 25).reshape(6, 4)[:, :3].tolist()


@pytest.mark.parametrize("change", [{"width": 9}, {"point_step": 4}, {"row_step": 1}])
def test_sizes_that_contradict_each_other_are_refused(change):
    message = cloud(np.ones((3, 3)), "time", [0, 0, 0], "f4")
    vars(message).update(change)
    with pytest.raises(ValueError, match=r"a cloud has .* bytes"):
        read_cloud(message)
