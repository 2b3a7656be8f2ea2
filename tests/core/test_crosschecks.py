"""Two measurements of one quantity: what contradicts, and what may differ."""

import math

import numpy as np
import pytest

from flipperctl.core import crosschecks
from flipperctl.core.crosschecks import Tilts

TIMES = np.arange(0, 10, 0.1)
NEVER = np.zeros(len(TIMES))
BUMP = 0.4 * np.sin(TIMES) * (TIMES > 3)


def pitched(angles):
    """The rotations of a chassis whose nose is down by angles, (N, 3, 3)."""
    c, s, zero = np.cos(angles), np.sin(angles), np.zeros(len(angles))
    rows = [[c, zero, s], [zero, zero + 1, zero], [-s, zero, c]]
    return np.moveaxis(np.array(rows), -1, 0)


def vertical(angles):
    """The vertical in such a chassis, (N, 3)."""
    return pitched(angles)[:, 2]


@pytest.mark.parametrize(
    ("attitude", "poses", "change", "lean"),
    [
        (vertical(BUMP), BUMP, 0.0, 0.0),
        (vertical(NEVER), BUMP, 0.4, None),  # never set, frozen, a heading alone
        (vertical(-BUMP), BUMP, 0.4, None),  # another sign: it differs by 0.8, and 0.4 is known
        (vertical(BUMP), NEVER, 0.0, None),  # planar poses tell no tilt
        (-vertical(BUMP), BUMP, 0.0, math.pi),  # z down
        (vertical(BUMP + 0.5), BUMP, 0.0, 0.5),  # mounted with a tilt that is not in tf
    ],
)
def test_an_attitude_against_the_recorded_poses(attitude, poses, change, lean):
    peaks = crosschecks.by_poses(TIMES, attitude, pitched(poses))
    assert peaks["attitude_poses"].size == pytest.approx(change, abs=0.02)
    if lean is not None:
        assert peaks["attitude_vertical"].size == pytest.approx(lean, abs=1e-6)


def test_an_attitude_against_gravity():
    level = vertical(NEVER)
    for scale in (9.81, 1.0):  # m/s², and in g
        peak = crosschecks.by_gravity(TIMES, level, scale * vertical(NEVER + 0.5))
        assert peak.size == pytest.approx(0.5)
        assert crosschecks.by_gravity(TIMES, level, scale * level).size < 1e-6
    assert crosschecks.by_gravity(TIMES, level, 0.0 * level) is None  # it has no accelerations
    assert crosschecks.by_gravity(TIMES, level, np.nan * level) is None


def by_rates(angles, rates, step=0.01):
    """The largest difference between pitches and rates of turn about y."""
    changes = Tilts()
    ups = vertical(np.asarray(angles))
    return max(
        changes.add(step * i, up, (0.0, rate, 0.0)).get("attitude_rates", 0.0)
        for i, (up, rate) in enumerate(zip(ups.tolist(), rates, strict=True))
    )


@pytest.mark.parametrize(
    ("angles", "rates", "size"),
    [
        (np.zeros(100), [0.3] * 100, 0.255),  # frozen or never set, a second long
        (0.003 * np.arange(100), [0.3] * 100, 0.0),
        (-0.003 * np.arange(100), [0.3] * 100, 0.255),  # another sign
        (0.003 * np.arange(100), [0.0] * 100, 0.0),  # rates that no one fills in tell nothing
        (np.zeros(1000), [0.02 * (-1) ** i for i in range(1000)], 0.0),  # noise of a gyroscope
        (np.zeros(1000), [0.01] * 1000, 0.03),  # its error does not add up
    ],
)
def test_an_attitude_against_turn_rates(angles, rates, size):
    assert by_rates(angles, rates) == pytest.approx(size, abs=0.006)


@pytest.mark.parametrize(("angle", "size"), [(0.0, 0.0), (0.5, 0.5)])
def test_an_attitude_against_accelerations_message_by_message(angle, size):
    tilts, rng = Tilts(), np.random.default_rng(0)
    up = vertical(np.array([angle]))[0]
    for i in range(200):
        push = 9.81 * up + rng.normal(size=3)  # of a robot that shakes
        last = tilts.add(0.01 * i, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), push.tolist())
    assert last["attitude_gravity"] == pytest.approx(size, abs=0.05)


def ways(speeds, way, noise=0.0):
    """What belts and poses, which drive ``way`` ahead along y, differ by."""
    places = np.column_stack([0 * way, way, 0 * way])
    places = places + noise * np.random.default_rng(0).normal(size=places.shape)
    ahead = np.tile([0.0, 1.0, 0.0], (len(way), 1))
    peaks = crosschecks.by_way(TIMES, np.asarray(speeds), TIMES, places, ahead)
    return (peaks["belts_short"].size, peaks["belts_long"].size) if peaks else None


HALF = np.where(TIMES < 5, 0.0, 0.2)
COARSE = np.where(np.arange(len(TIMES)) % 2, 0.0, 0.4)
LATE = np.maximum(0, TIMES - 3)


@pytest.mark.parametrize(
    ("speeds", "way", "differ"),
    [
        (0.2 + NEVER, 0.2 * TIMES, (0.0, 0.0)),
        (NEVER, 0.2 * TIMES, (1.0, -1.0)),  # never filled in, or along the axes of the world
        (HALF, 0.2 * TIMES, (0.5, None)),
        (0.0002 + NEVER, 0.2 * TIMES, (0.999, None)),  # km/s
        (200 + NEVER, 0.2 * TIMES, (0.0, 999)),  # mm/s
        (-0.2 + NEVER, 0.2 * TIMES, (2.0, -2.0)),
        (COARSE, 0.2 * TIMES, (0.0, 0.0)),  # of an encoder
        (0.2 * (TIMES > 3), 0.2 * LATE, (0.0, 0.0)),  # it starts late
    ],
)
def test_belts_against_the_way_of_the_poses(speeds, way, differ):
    for size, expected in zip(ways(speeds, way), differ, strict=True):
        assert expected is None or size == pytest.approx(expected, rel=0.01, abs=0.06)


def test_a_robot_that_stands_by_noisy_poses_or_slips_is_not_compared():
    assert ways(NEVER, NEVER, noise=0.02) is None
    assert ways(0.3 + NEVER, NEVER) is None


def test_stamps_against_the_clock_of_the_recording():
    peaks, delay = crosschecks.by_clock(TIMES + 0.2, TIMES)
    assert [round(peak.size, 6) for peak in peaks.values()] == [0, 0, 0]
    assert delay == pytest.approx(0.2)
    back, _ = crosschecks.by_clock(TIMES, TIMES - 5 * (TIMES > 6))
    assert (back["stamps_back"].size, back["stamps_clock"].size) == pytest.approx((4.9, 5.0))
    assert back["stamps_back"].time == pytest.approx(6.0)
    ahead, _ = crosschecks.by_clock(TIMES, TIMES + 5 * (TIMES > 6))
    assert (ahead["stamps_back"].size, ahead["stamps_clock"].size) == pytest.approx((0, 5.0))
    still, _ = crosschecks.by_clock(TIMES, np.minimum(TIMES, 5.0))
    assert still["stamps_equal"].size == pytest.approx(49 / 99)
    arrived = np.maximum.accumulate(TIMES + 0.9 * (np.arange(100) % 20 == 5))
    stalled, _ = crosschecks.by_clock(arrived, TIMES)
    assert stalled["stamps_clock"].size < 1e-9  # a network that stalls now and then


def steps(places, times=TIMES, turns=None):
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
    places = np.column_stack([places, 0 * places, 0 * places])
    peaks = crosschecks.by_steps(times, places, level if turns is None else turns)
    return tuple(peak.size for peak in peaks.values())


def test_poses_of_a_link_against_those_before_and_after():
    way = 0.2 * TIMES
    assert steps(way) == (0, 0)
    both = np.repeat(TIMES, 2) + np.tile([0, 0.004], 100)  # two publishers, by turns
    returns, jump = steps(np.repeat(way, 2) * np.tile([1, 0.7], 100), both)
    assert returns == pytest.approx(0.5, abs=0.15)
    assert jump < returns
    slow = np.repeat(TIMES[::10], 2) + np.tile([0, 0.004], 10)  # of one pose a second
    assert steps(0.2 * slow + 0.8 * np.tile([0, 1], 10), slow)[0] == pytest.approx(0.6, abs=0.01)
    returns, jump = steps(way + 0.4 * (TIMES > 7))
    assert (returns, jump) == (0, pytest.approx(0.42))
    assert steps(way + 0.4 * (np.arange(100) == 50))[0] == 0  # a single wrong pose
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (100, 1))
    turns[50:] = 0, 0, math.sin(0.2), math.cos(0.2)
    assert steps(0 * way, turns=turns)[1] == pytest.approx(0.4)  # [rad], of a length of 1 m


def test_a_cloud_that_is_repeated_while_the_robot_moves_tells_nothing_new():
    moved = 0.02 * np.arange(10)
    again, peak = crosschecks.repeats([1, 2, 3, 3, 3, 3, 3, 4, 5, 6], moved)
    assert np.flatnonzero(again).tolist() == [5, 6]
    assert peak.size == pytest.approx(0.08)
    assert not crosschecks.repeats([1] * 10, 0 * moved)[0].any()  # it stands


def test_the_rounding_of_heights_is_that_of_their_format():
    stairs = 300 + 0.17 * np.arange(6)
    assert crosschecks.rounding(stairs) == 0
    assert crosschecks.rounding(stairs.astype(np.float16).astype(float)) == 0.25
    assert crosschecks.rounding(stairs.astype(np.float32).astype(float)) == 0  # no step of 3e-5
    assert crosschecks.rounding(np.round(stairs), whole=True) == 0  # two heights are no rounding
    assert crosschecks.rounding(np.round(stairs * 4), whole=True) == 1


def test_a_difference_says_what_it_means_and_its_largest_counts():
    small, large = (
        crosschecks.compared(source, joints_pair=crosschecks.Peak(size, 12.0))[0]
        for source, size in (("rear", 0.2), ("front", 1.8))
    )
    assert crosschecks.largest([large, small]) == [large]
    assert (small.verdict, large.verdict) == ("warned", "refused")
    assert "front: angle, left joint against right joint: 1.8 rad at 2.0 s" in large.sentence(10.0)
    assert large.row(10.0)["seconds"] == 2.0
    assert len({check.name for check in crosschecks.CHECKS}) == len(crosschecks.CHECKS)
