"""Stairwells, courses, excerpts, rough ground, and starts and finishes on the ground."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from flipperctl_plugins.terrains.rough import Rough

from flipperctl.api import Profile
from flipperctl.config import resolver


def drawn(name: str, seed: int = 0, **fields: Any) -> Profile:
    found = resolver.create("terrain", {"name": name, **fields}, "terrain")
    profile = found.labelled(np.random.default_rng(seed))
    assert isinstance(profile, Profile)
    return profile


STEEP = {"slope_low": 45, "slope_high": 45, "stride_low": 0.6, "stride_high": 0.6}
"""45° and a stride of 0.6 m: rise and tread are 0.2 m."""
FLIGHTS = {"fewest": 2, "most": 2, "landing_low": 1.0, "landing_high": 1.0}


def test_a_stairwell_turns_after_a_landing() -> None:
    fields = {**STEEP, **FLIGHTS, "flights_low": 3, "flights_high": 3, "up": 1.0}
    profile = drawn("stairwell", turn=1.0, **fields)
    up = [(0, 0), (0, 0.2), (0.2, 0.2), (0.2, 0.4)]
    down = [(1.2, 0.4), (1.2, 0.2), (1.4, 0.2), (1.4, 0.0)]
    again = [(x + 2.4, z) for x, z in up]
    assert profile.points == pytest.approx(np.array(up + down + again))
    assert profile.drawn == {
        **{"steps": 6, "flights": 3, "turns": 2, "up": 1},
        **{"slope": 45, "rise": pytest.approx(0.2), "tread": pytest.approx(0.2)},
    }
    straight = drawn("stairwell", turn=0.0, **fields)
    assert straight.points[-1] == pytest.approx((2.6, 1.2))


def test_a_course_draws_its_obstacles_anew() -> None:
    parts = [{"name": "step", "low": 0.3, "high": 0.3}, "gap", "wave"]
    fields = {"parts": parts, "weights": [1, 1, 0], "spacing_low": 0.5, "spacing_high": 0.5}
    counts, kinds = Counter[float](), Counter[float]()
    for seed in range(60):
        found = drawn("course", seed, fewest=2, most=5, **fields)
        places = [value for name, value in found.drawn.items() if name.startswith("kind")]
        counts[found.drawn["obstacles"]] += 1
        kinds.update(places)
        assert len(places) == found.drawn["obstacles"]
        # Each step raises all that follows; gaps return to their height.
        assert found.points[-1, 1] == pytest.approx(0.3 * places.count(0))
        assert found.label == "course"
    assert set(counts) == {2, 3, 4, 5}
    assert set(kinds) == {0, 1}


def test_rough_ground_has_the_stated_spectrum() -> None:
    rough = Rough(longest=2.0, shortest=0.5)
    waves, amplitudes = rough.spectrum(1000.0, 2.0)
    # The variance is the integral of G(0.1) · 0.01 / n² from 0.5 to 2 cycles/m, G in m³.
    assert (amplitudes**2 / 2).sum() == pytest.approx(1e-3 * 0.01 * (1 / 0.5 - 1 / 2), rel=0.01)
    assert waves[0] > 0.5
    assert waves[-1] < 2.0
    exact = {"roughness_low": 1000.0, "roughness_high": 1000.0, "exponent_low": 2.0}
    long = {"exponent_high": 2.0, "length_low": 40.0, "length_high": 40.0}
    profile = drawn("rough", longest=2.0, shortest=0.5, **exact, **long)
    assert profile.points[0].tolist() == [0.0, 0.0]
    assert profile.points[:, 1].std() == pytest.approx(math.sqrt(1.5e-5), rel=0.1)
    assert profile.drawn["deviation"] == pytest.approx(profile.points[:, 1].std())
    with pytest.raises(ValueError, match="longest"):
        Rough(longest=0.3, shortest=0.5)


def test_an_excerpt_is_a_piece_of_the_ground() -> None:
    stairs = {"name": "building_stair", "fewest": 16, "most": 16, "direction": "up"}
    firsts = set()
    for seed in range(5):
        piece = drawn("excerpt", seed, terrain=stairs, length_low=2.0, length_high=2.0)
        assert piece.end - piece.start == pytest.approx(2.0)
        assert piece.drawn["piece_length"] == pytest.approx(2.0)
        # What the piece does not draw itself is the ground's own.
        whole = resolver.create("terrain", stairs, "terrain").labelled(np.random.default_rng(seed))
        x = np.linspace(piece.start + 0.01, piece.end - 0.01, 50)
        assert piece.heights(x) == pytest.approx(whole.heights(x))
        firsts.add(piece.drawn["piece_start"])
    assert len(firsts) == 5


@pytest.mark.parametrize("ground", ["gap", "step", "stair", "building_stair"])
def test_an_excerpt_of_shorter_ground_is_all_of_it(ground: str) -> None:
    whole, piece = (
        drawn(name, 4, **fields)
        for name, fields in (
            (ground, {}),
            ("excerpt", {"terrain": ground, "length_low": 90.0, "length_high": 90.0}),
        )
    )
    assert np.array_equal(piece.points, whole.points)  # with the faces at its ends
    assert piece.drawn["piece_length"] == whole.end - whole.start


def test_an_episode_begins_and_ends_midway() -> None:
    stairs = {"name": "building_stair", "fewest": 12, "most": 12}
    for seed in range(20):
        both = drawn("midway", seed, terrain=stairs, start=1, finish=1, shortest=1.5)
        assert both.run_up is not None
        assert both.run_out is not None
        assert both.run_up <= 0
        assert both.run_out <= 0
        assert both.end - both.start + both.run_up + both.run_out >= 1.5 - 1e-9
        assert both.drawn["start_on"] == -both.run_up
    neither = drawn("midway", terrain=stairs, start=0, finish=0)
    assert (neither.run_up, neither.run_out) == (None, None)
    short = drawn("midway", terrain="step", start=1, finish=1)
    assert (short.run_up, short.run_out) == (None, None)
    inner = {"name": "midway", "terrain": stairs, "start": 1, "finish": 1}
    around = drawn("midway", terrain=inner, start=0, finish=0)
    assert not {"start_on", "finish_on"} & around.drawn.keys()  # it starts before the first edge


def test_ground_around_midway_moves_its_ends() -> None:
    midway = {"name": "midway", "start": 1, "finish": 0}
    inner = drawn("midway", 3, start=1, finish=0)
    mirrored = drawn("mirror", 3, terrain=midway)
    assert inner.run_up is not None
    assert (mirrored.run_up, mirrored.run_out) == (None, inner.run_up)
    noisy = drawn("noisy", 3, terrain=midway, margin=0.5)
    assert noisy.run_up == pytest.approx(inner.run_up - 0.5)  # its first edge is 0.5 m before
    assert noisy.run_out is None


def test_the_mix_of_all_courses_has_everything() -> None:
    mix, rng = resolver.create("terrain", "all_courses", "terrain"), np.random.default_rng(1)
    found = [mix.labelled(rng) for _ in range(400)]
    labels = {profile.label for profile in found}
    assert {"course", "stairwell", "rough", "step", "gap", "pallet", "plum", "ramp"} <= labels
    assert max(p.drawn["steps"] for p in found if p.label == "building_stair") == 16
    assert min(p.drawn["height"] for p in found if p.label == "step") < -0.6
    assert any(p.run_up is not None for p in found)
    assert any(p.run_out is not None for p in found)


def test_hard_courses_have_more_of_what_is_learnt_last() -> None:
    shares = {}
    for name in ("all_courses", "hard_courses"):
        mix, rng = resolver.create("terrain", name, "terrain"), np.random.default_rng(2)
        found = [mix.labelled(rng) for _ in range(400)]
        shares[name] = Counter(
            "deep gap" if profile.drawn.get("depth", 0) > 0.5 else profile.label
            for profile in found
        )
    for label in ("deep gap", "ramp", "plum", "building_stair"):
        assert shares["hard_courses"][label] > shares["all_courses"][label]
    assert shares["all_courses"].keys() <= shares["hard_courses"].keys()


def test_ground_within_other_ground_keeps_no_start_of_its_own() -> None:
    midway = {"name": "midway", "start": 1, "finish": 1}
    sequence = drawn("sequence", parts=[midway, "step"])
    excerpt = drawn("excerpt", terrain=midway)
    assert sequence.run_up is sequence.run_out is excerpt.run_up is excerpt.run_out is None
    for profile in (sequence, excerpt):
        assert not any("start_on" in name or "finish_on" in name for name in profile.drawn)
    assert "part2_height" in sequence.drawn
