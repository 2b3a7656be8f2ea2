"""The outlines of the terrain families, of courses and of excerpts against numbers by hand."""

import math
import os
import platform
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from flipperctl_plugins.terrains.rough import Rough

from flipperctl.api import Profile
from flipperctl.config import resolver

FAMILIES = "building_stair curb_and_ramp gap pallet plates plum rail ramp rubble uplift wave"


def drawn(name: str, seed: int = 0, **fields: object) -> Profile:
    found = resolver.create("terrain", {"name": name, **fields}, "terrain")
    return found.labelled(np.random.default_rng(seed))


def test_a_ramp_of_30_degrees_rises_by_half_its_length_and_leads_back() -> None:
    run = math.cos(math.radians(30))
    profile = drawn("ramp", slope=30, length=1.0, platform=2.0, direction="up")
    expected = [(0, 0), (run, 0.5), (run + 2, 0.5), (2 * run + 2, 0)]
    assert profile.points == pytest.approx(np.array(expected))
    valley = drawn("ramp", slope=30, length=1.0, platform=2.0, direction="down")
    assert valley.points[:, 1] == pytest.approx(-profile.points[:, 1])
    assert drawn("ramp", back=False).points.shape == (2, 2)


def test_a_gap_is_an_uplift_upside_down() -> None:
    block = drawn("uplift", height=0.3, width=0.4).points
    assert block.tolist() == [[0, 0], [0, 0.3], [0.4, 0.3], [0.4, 0]]
    trench = drawn("gap", depth=0.3, width=0.4).points
    assert trench.tolist() == (block * (1, -1)).tolist()


def test_a_wave_has_its_crests_half_a_length_past_its_troughs() -> None:
    profile = drawn("wave", length=0.8, height=0.3, waves=2)
    assert profile.end == pytest.approx(1.6)
    for x, z in ((0.0, 0.0), (0.2, 0.15), (0.4, 0.3), (0.8, 0.0), (1.2, 0.3), (1.6, 0.0)):
        assert profile.height(x) == pytest.approx(z)


def test_a_rail_grows_by_the_sine_of_the_angle_at_which_it_is_crossed() -> None:
    profile = drawn("rail", side=0.2, angle=30, gauge=0.3, bars=2)
    assert profile.points[:, 0] == pytest.approx([0, 0, 0.4, 0.4, 1.0, 1.0, 1.4, 1.4])
    assert profile.points[:, 1] == pytest.approx([0, 0.2, 0.2, 0, 0, 0.2, 0.2, 0])
    assert drawn("rail", side=0.2, angle=90, bars=1).end == pytest.approx(0.2)


def test_hurdles_are_equal_and_piles_are_not() -> None:
    hurdles = drawn("pallet", hurdles=3).points
    assert len(set(hurdles[1::4, 1])) == 1
    assert hurdles[2::4, 0] - hurdles[1::4, 0] == pytest.approx(hurdles[2, 0] - hurdles[1, 0])
    piles = drawn("plum", piles=3).points
    assert len(set(piles[1::4, 1])) == 3
    for points in (hurdles, piles):
        assert set(points[0::4, 1]) == set(points[3::4, 1]) == {0.0}


@pytest.mark.parametrize(
    ("tangent", "x"),
    [(0, [0, 0, 0.02, 0.02]), (0.5, [0, 0.1, 0.12, 0.12]), (-0.5, [0, 0, 0.02, 0.12])],
)
def test_a_plate_leans_by_its_tilt_over_filled_ground(tangent: float, x: list[float]) -> None:
    tilt = math.degrees(math.atan(tangent))
    fields = {"thickness": 0.02, "height": 0.2, "clearance": 0.3, "plates": 2}
    profile = drawn("plates", tilt=tilt, **fields)
    second = [x[-1] + 0.3 + at for at in x]
    assert profile.points[:, 0] == pytest.approx([*x, *second])
    assert profile.points[:, 1].tolist() == [0, 0.2, 0.2, 0] * 2
    assert profile.drawn == {"plates": 2, "height": 0.2, "thickness": 0.02, "tilt": tilt}


def test_a_pavement_has_its_curb_at_either_end() -> None:
    found = set()
    for seed in range(10):
        profile = drawn("curb_and_ramp", seed, height=0.2, slope=45, width=1.0)
        assert profile.end == pytest.approx(1.2)
        found.add(tuple(np.round(profile.points[:, 0], 9)))
    assert found == {(0.0, 0.0, 1.0, 1.2), (0.0, 0.2, 1.2, 1.2)}


@pytest.mark.parametrize(
    ("slope", "rise", "tread"), [(45, 0.21, 0.21), (math.degrees(math.atan(0.5)), 0.1575, 0.315)]
)
def test_a_buildings_stair_keeps_to_the_stride(slope: float, rise: float, tread: float) -> None:
    points = drawn("building_stair", slope=slope, stride=0.63, steps=3, direction="up").points
    assert np.diff(points[:, 1])[::2] == pytest.approx([rise] * 3)
    assert np.diff(points[:, 0])[1::2] == pytest.approx([tread] * 2)
    assert points.shape == (6, 2)


def test_a_landing_replaces_the_tread_after_every_few_steps() -> None:
    points = drawn(
        "stair", steps=5, direction="up", landing_every=2, landing=1.0, platform=2.0
    ).points
    # Faces at 0, 0.3, then 1 m of landing, 1.6, another landing, 2.6; none after the last step.
    assert points[::2, 0] == pytest.approx([0.0, 0.3, 1.3, 1.6, 2.6, 4.6])
    assert points[1::2, 1] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    down = drawn(
        "building_stair", slope=45, stride=0.63, steps=16, direction="down",
        landing_every=8, landing=1.2,
    ).points  # fmt: skip
    assert down[-1] == pytest.approx([14 * 0.21 + 1.2, -16 * 0.21])
    for name in ("stair", "building_stair", "paper_stair"):
        for seed in range(5):
            plain = drawn(name, seed, landing_every=0, landing=5.0)
            assert plain.points.tobytes() == drawn(name, seed).points.tobytes()


def test_terrains_tell_what_they_drew() -> None:
    stair = drawn("stair", tread_spread=0.05)
    treads = np.diff(stair.points[::2, 0])
    assert stair.drawn["steps"] == len(stair.points) / 2
    assert stair.drawn["tread"] == pytest.approx(treads[0])
    assert stair.drawn["up"] == (stair.points[-1, 1] > 0)
    assert drawn("step").drawn["height"] == drawn("step").points[-1, 1]
    building = drawn("building_stair", slope=30).drawn
    assert building["slope"] == 30
    assert building["rise"] / building["tread"] == pytest.approx(math.tan(math.radians(30)))


def test_composed_terrains_pass_on_what_their_parts_drew() -> None:
    turned = drawn("mirror", terrain="stair", probability=1.0).drawn
    assert (turned["mirrored"], turned["steps"] in (3, 4, 5)) == (1, True)
    twice = drawn("mirror", terrain={"name": "mirror", "terrain": "step"})
    assert twice.drawn["mirrored"] == 0
    assert np.array_equal(twice.points, drawn("step").points)
    assert drawn("noisy").drawn.keys() == drawn("stair").drawn.keys()
    assert drawn("mix", parts=["gap"]).drawn.keys() == {"width", "depth"}
    row = drawn("sequence", parts=["stair", "stair"]).drawn
    assert {"part1_steps", "part2_steps"} <= row.keys()


def test_rubble_leaves_no_gap_between_its_blocks() -> None:
    points = drawn("rubble", blocks=5, width=0.2).points
    assert np.unique(np.round(points[:, 0], 9)) == pytest.approx(np.arange(6) * 0.2)
    assert points[0].tolist() == [0.0, 0.0]
    assert points[-1, 1] == 0.0


@pytest.mark.parametrize("name", FAMILIES.split())
def test_a_family_stays_within_its_ranges_and_every_profile_differs(name: str) -> None:
    profiles = [drawn(name, seed) for seed in range(10)]
    assert len({p.points.tobytes() for p in profiles}) == 10
    highest = resolver.create("terrain", name, "terrain").model_dump().get("height", (0.0, 20.0))
    assert max(p.points[:, 1].max() for p in profiles) <= highest[1]
    assert {(p.label, *p.points[0]) for p in profiles} == {(name, 0.0, 0.0)}


STEEP = {"slope": 45, "stride": 0.6}
"""45° and a stride of 0.6 m: rise and tread are 0.2 m."""
FLIGHTS = {"steps": 2, "landing": 1.0}


def test_a_stairwell_turns_after_a_landing() -> None:
    fields = {**STEEP, **FLIGHTS, "flights": 3, "up": 1.0}
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
    parts = [{"name": "step", "height": 0.3}, "gap", "wave"]
    fields = {"parts": parts, "weights": [1, 1, 0], "spacing": 0.5}
    counts, kinds = Counter[float](), Counter[float]()
    for seed in range(60):
        found = drawn("course", seed, obstacles=[2, 5], **fields)
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
    exact = {"roughness": 1000.0, "exponent": 2.0, "length": 40.0}
    profile = drawn("rough", longest=2.0, shortest=0.5, **exact)
    assert profile.points[0].tolist() == [0.0, 0.0]
    assert profile.points[:, 1].std() == pytest.approx(math.sqrt(1.5e-5), rel=0.1)
    assert profile.drawn["deviation"] == pytest.approx(profile.points[:, 1].std())
    with pytest.raises(ValueError, match="longest"):
        Rough(longest=0.3, shortest=0.5)


def test_an_excerpt_is_a_piece_of_the_ground() -> None:
    stairs = {"name": "building_stair", "steps": 16, "direction": "up"}
    firsts = set()
    for seed in range(5):
        piece = drawn("excerpt", seed, terrain=stairs, length=2.0)
        assert piece.end - piece.start == pytest.approx(2.0)
        assert piece.drawn["piece_length"] == pytest.approx(2.0)
        # What the piece does not draw itself is the ground's own.
        whole = resolver.create("terrain", stairs, "terrain").labelled(np.random.default_rng(seed))
        x = np.linspace(piece.start + 0.01, piece.end - 0.01, 50)
        assert piece.heights(x) == pytest.approx(whole.heights(x))
        firsts.add(piece.drawn["piece_start"])
    assert len(firsts) == 5


@pytest.mark.parametrize("ground", ["gap", "stair"])
def test_an_excerpt_of_shorter_ground_is_all_of_it(ground: str) -> None:
    whole, piece = (
        drawn(name, 4, **fields)
        for name, fields in ((ground, {}), ("excerpt", {"terrain": ground, "length": 90.0}))
    )
    assert np.array_equal(piece.points, whole.points)  # with the faces at its ends
    assert piece.drawn["piece_length"] == whole.end - whole.start


def test_an_episode_begins_and_ends_midway() -> None:
    stairs = {"name": "building_stair", "steps": 12}
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
    wanted = "course stairwell rough step gap pallet plates plum ramp"
    assert labels.issuperset(wanted.split())
    assert max(p.drawn["steps"] for p in found if p.label == "building_stair") == 16
    assert min(p.drawn["height"] for p in found if p.label == "step") < -0.6
    assert any(p.run_up is not None for p in found)
    assert any(p.run_out is not None for p in found)


def test_ground_within_other_ground_keeps_no_start_of_its_own() -> None:
    midway = {"name": "midway", "start": 1, "finish": 1}
    sequence = drawn("sequence", parts=[midway, "step"])
    excerpt = drawn("excerpt", terrain=midway)
    assert sequence.run_up is sequence.run_out is excerpt.run_up is excerpt.run_out is None
    for profile in (sequence, excerpt):
        assert not any("start_on" in name or "finish_on" in name for name in profile.drawn)
    assert "part2_height" in sequence.drawn


OF_GROUND = """
import hashlib, numpy as np
from flipperctl.config import resolver
from flipperctl.plugging import plugins
plugins.load()
for name in "{names}".split():
    terrain, sha = resolver.create("terrain", {{"name": name}}, "terrain"), hashlib.sha256()
    for seed in range(20):
        sha.update(terrain.labelled(np.random.default_rng(seed)).points.tobytes())
    print(name, sha.hexdigest())
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names features of x86")
def test_ground_is_the_same_bits_on_an_older_processor() -> None:
    code = OF_GROUND.format(names=f"{FAMILIES} rough lip damaged_stair")
    other = {"NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4", "OPENBLAS_CORETYPE": "Nehalem"}
    here, there = (
        subprocess.run(
            [sys.executable, "-c", code], env=os.environ | more, check=True, capture_output=True
        ).stdout
        for more in ({}, other)
    )
    assert here == there
    assert here.count(b"\n") == 14
