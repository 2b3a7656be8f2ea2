"""Errors of a map as a model in the plane."""

import numpy as np
import pytest

from flipperctl.api import Profile, RobotState
from flipperctl.cli.scenes import scenes
from flipperctl.evaluation.conditions import Conditions
from flipperctl.sim.planar import PlanarSensor, TerrainSensor
from flipperctl.sim.planar.map_errors import NEAREST, MapErrors, MapErrorSize, correlated

STEP = Profile([(-6.0, 0.0), (0.0, 0.0), (0.0, 0.2), (6.0, 0.2)])


def state(x: float) -> RobotState:
    return RobotState(np.array([x, 0.1]), 0.0, 0.0, 0.0, np.zeros(2), 0.0, 0.0)


def sensed(of: TerrainSensor, x: float, rng: np.random.Generator) -> np.ndarray:
    return of.sense(state(x), rng)[0].points


def test_the_process_has_unit_variance_and_its_length() -> None:
    x = np.linspace(0.0, 3999.9, 40000)
    found = correlated(x, 0.2, np.random.default_rng(1))
    assert found.std() == pytest.approx(1.0, abs=0.03)
    for lag in (1, 3):
        got = np.mean(found[lag:] * found[:-lag])
        assert got == pytest.approx(np.exp(-lag * 0.5), abs=0.03)


def test_an_error_of_the_heights_stays_at_its_place() -> None:
    of = TerrainSensor(STEP, PlanarSensor(map_error=0.01), 3.0)
    rng = np.random.default_rng(3)
    first = sensed(of, -2.0, rng) + np.array([-2.0, 0.1])
    later = sensed(of, -1.4, rng) + np.array([-1.4, 0.1])
    assert 0.002 < np.abs(first[:, 1]).max() < 0.05
    both = (later[:, 0] > -2.5) & (later[:, 0] < -0.9)
    again = np.interp(later[both, 0], first[:, 0], first[:, 1])
    assert later[both, 1] == pytest.approx(again, abs=1e-9)


def test_what_was_passed_is_displaced_by_the_error_of_odometry_since() -> None:
    x = np.array([0.0, 1.0, 2.0])
    errors = MapErrors(x, MapErrorSize(0.0, 1.0, 0.04))
    rng, same = np.random.default_rng(5), np.random.default_rng(5)
    same.standard_normal(4)  # three heights, and the first decision, before the robot has moved
    errors.advance(0.5 - NEAREST, rng)
    errors.advance(1.5 - NEAREST, rng)  # now the points at 0 and 1 m are passed
    step = 0.04 * same.standard_normal()  # 1 m of the way
    errors.advance(1.6 - NEAREST, rng)
    last = 0.04 * np.sqrt(0.1) * same.standard_normal()
    points = np.column_stack([x, np.zeros(3)])
    errors.apply(points, slice(None))
    # The first was seen last before the first metre, the second before the last 0.1 m.
    assert points[:, 0] - x == pytest.approx([-step - last, -step - last, 0.0])


def test_jitter_displaces_all_of_the_ground_anew_at_each_decision() -> None:
    x = np.array([0.0, 1.0, 2.0])
    errors = MapErrors(x, MapErrorSize(0.0, 1.0, 0.0, 0.01))
    rng, same = np.random.default_rng(5), np.random.default_rng(5)
    same.standard_normal(3)  # the heights
    for _ in range(3):
        errors.advance(0.5, rng)
        points = np.column_stack([x, np.zeros(3)])
        errors.apply(points, slice(None))
        _, drawn = same.standard_normal(2)  # the first one is odometry's
        assert points[:, 0] - x == pytest.approx([0.01 * drawn] * 3)
    saved = errors.save()
    errors.advance(0.5, rng)
    errors.load(saved)
    again = np.column_stack([x, np.zeros(3)])
    errors.apply(again, slice(None))
    assert np.array_equal(again, points)


def test_points_stay_in_order_and_within_reach_and_a_snapshot_repeats_them() -> None:
    for occlusion in (False, True):
        of = TerrainSensor(
            STEP, PlanarSensor(map_drift=0.3, map_jitter=0.1, occlusion=occlusion), 3.0
        )
        rng = np.random.default_rng(2)
        for x in np.arange(-2.0, 0.5, 0.12):
            points = sensed(of, x, rng)
            assert (np.diff(points[:, 0]) >= 0).all()
            assert (np.abs(points[:, 0]) <= 1.125).all()
        saved, bits = of.save(), rng.bit_generator.state
        once = sensed(of, 0.6, rng)
        of.load(saved)
        rng.bit_generator.state = bits
        assert np.array_equal(sensed(of, 0.6, rng), once)


def test_without_it_hashes_of_conditions_are_as_before() -> None:
    ((plain, _),) = scenes(["terrain=step"], None, "okada")
    ((other, _),) = scenes(["terrain=step", "perception.map_length=1"], None, "okada")
    ((wrong, _),) = scenes(["terrain=step", "perception.map_error=0.01"], None, "okada")
    assert "map_jitter" not in Conditions.of(wrong).settings["perception"]
    assert "map_error" not in Conditions.of(plain).settings["perception"]
    assert Conditions.of(plain).hash == Conditions.of(other).hash != Conditions.of(wrong).hash


def test_the_length_of_errors_counts_where_they_are_sampled() -> None:
    words = ["terrain=step", "conditions=widest"]
    ((widest, _),) = scenes(words, None, "okada")
    ((longer, _),) = scenes([*words, "perception.map_length=4"], None, "okada")
    ((usual, _),) = scenes([*words, "perception.map_length=2"], None, "okada")
    assert Conditions.of(longer).settings["perception"]["map_length"] == 4
    assert Conditions.of(longer).hash != Conditions.of(widest).hash == Conditions.of(usual).hash
    assert "map_length" not in Conditions.of(widest).settings["perception"]  # as it was hashed
