"""The outlines of the terrain families against numbers worked by hand."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile
from flipperctl.config import resolver

FAMILIES = (
    "building_stair",
    "curb_and_ramp",
    "gap",
    "pallet",
    "plum",
    "rail",
    "ramp",
    "rubble",
    "uplift",
    "wave",
)


def drawn(name: str, seed: int = 0, **fields: object) -> Profile:
    """Return a profile; ``height=0.3`` sets both ``height_low`` and ``height_high``."""
    cls = resolver.get("terrain", name, "terrain")
    settings = {}
    for field, value in fields.items():
        both = f"{field}_low" in cls.model_fields
        settings |= {f"{field}_low": value, f"{field}_high": value} if both else {field: value}
    found = resolver.create("terrain", {"name": name, **settings}, "terrain")
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
    profile = drawn("wave", length=0.8, height=0.3, fewest=2, most=2)
    assert profile.end == pytest.approx(1.6)
    for x, z in ((0.0, 0.0), (0.2, 0.15), (0.4, 0.3), (0.8, 0.0), (1.2, 0.3), (1.6, 0.0)):
        assert profile.height(x) == pytest.approx(z)


def test_a_rail_grows_by_the_sine_of_the_angle_at_which_it_is_crossed() -> None:
    profile = drawn("rail", side=0.2, angle=30, gauge=0.3, fewest=2, most=2)
    assert profile.points[:, 0] == pytest.approx([0, 0, 0.4, 0.4, 1.0, 1.0, 1.4, 1.4])
    assert profile.points[:, 1] == pytest.approx([0, 0.2, 0.2, 0, 0, 0.2, 0.2, 0])
    assert drawn("rail", side=0.2, angle=90, most=1).end == pytest.approx(0.2)


def test_hurdles_are_equal_and_piles_are_not() -> None:
    hurdles = drawn("pallet", fewest=3, most=3).points
    assert len(set(hurdles[1::4, 1])) == 1
    assert hurdles[2::4, 0] - hurdles[1::4, 0] == pytest.approx(hurdles[2, 0] - hurdles[1, 0])
    piles = drawn("plum", fewest=3, most=3).points
    assert len(set(piles[1::4, 1])) == 3
    for points in (hurdles, piles):
        assert set(points[0::4, 1]) == set(points[3::4, 1]) == {0.0}


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
    points = drawn(
        "building_stair", slope=slope, stride=0.63, fewest=3, most=3, direction="up"
    ).points
    assert np.diff(points[:, 1])[::2] == pytest.approx([rise] * 3)
    assert np.diff(points[:, 0])[1::2] == pytest.approx([tread] * 2)
    assert points.shape == (6, 2)


def test_a_landing_replaces_the_tread_after_every_few_steps() -> None:
    points = drawn(
        "stair", fewest=5, most=5, direction="up", landing_every=2, landing=1.0, platform=2.0
    ).points
    # Faces at 0, 0.3, then 1 m of landing, 1.6, another landing, 2.6; none after the last step.
    assert points[::2, 0] == pytest.approx([0.0, 0.3, 1.3, 1.6, 2.6, 4.6])
    assert points[1::2, 1] == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    down = drawn(
        "building_stair", slope=45, stride=0.63, fewest=16, most=16, direction="down",
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
    points = drawn("rubble", fewest=5, most=5, width=0.2).points
    assert np.unique(np.round(points[:, 0], 9)) == pytest.approx(np.arange(6) * 0.2)
    assert points[0].tolist() == [0.0, 0.0]
    assert points[-1, 1] == 0.0


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_stays_within_its_ranges_and_every_profile_differs(name: str) -> None:
    profiles = [drawn(name, seed) for seed in range(30)]
    assert len({p.points.tobytes() for p in profiles}) == 30
    assert {p.label for p in profiles} == {name}
    fields = resolver.create("terrain", name, "terrain").model_dump()
    if "height_high" in fields:
        assert max(p.points[:, 1].max() for p in profiles) <= fields["height_high"]
    for profile in profiles:
        assert profile.points[0] == pytest.approx([0, 0])


def test_a_reversed_range_is_named() -> None:
    with pytest.raises(Exception, match=r"width_low \(0\.9\) must not exceed width_high \(0\.5\)"):
        resolver.create("terrain", {"name": "uplift", "width_low": 0.9}, "terrain")
