"""The contract's values: profiles, actions, the layout of an observation, and old names."""

import math

import numpy as np
import pytest

from flipperctl import api
from flipperctl.api import ACTIONS, ObservationLayout, Profile, RobotGeometry, action_index

# A ramp of 1 : 2 over 2 m, a face of 1 m down, and 1 m of ground below
RAMP = Profile([(0.0, 0.0), (2.0, 1.0), (2.0, 0.0), (3.0, -0.5)])


@pytest.mark.parametrize(
    ("x", "height"),
    [
        (-5.0, 0.0),  # level before
        (0.0, 0.0),
        (0.5, 0.25),
        (2.0, 1.0),  # the higher of the two at the face
        (2.5, -0.25),
        (3.0, -0.5),
        (9.0, -0.5),  # level past the end
    ],
)
def test_height(x: float, height: float) -> None:
    assert RAMP.height(x) == pytest.approx(height)


def test_start_and_end_are_the_first_and_the_last_edge() -> None:
    assert (RAMP.start, RAMP.end) == (0.0, 3.0)


def test_extended_adds_level_ground_on_both_sides() -> None:
    line = RAMP.extended(1.0, 4.0)
    assert len(line) == 6
    assert line[0].tolist() == [-1.0, 0.0]
    assert line[-1].tolist() == [7.0, -0.5]


def test_samples_lie_evenly_along_the_outline_faces_included() -> None:
    step = Profile([(0.0, 0.0), (0.0, 0.4)])
    expected = [(-0.2, 0), (-0.1, 0), (0, 0), (0, 0.1), (0, 0.2), (0, 0.3), (0, 0.4), (0.1, 0.4)]
    assert step.sample(0.1, 0.2)[:8] == pytest.approx(np.array(expected), abs=1e-9)
    assert np.diff(RAMP.sample(0.03, 1.0)[:, 0]).min() >= 0


def test_around_gives_the_terrain_within_reach() -> None:
    points = RAMP.around(1.0, 0.5)
    assert points[:, 0].min() == pytest.approx(0.5, abs=0.02)
    assert points[:, 0].max() == pytest.approx(1.5, abs=0.02)
    assert points[:, 1] == pytest.approx(points[:, 0] / 2)
    # 1 m of x is √(1 + 1/4) = 1.118 m of ramp, a point every 0.02 m
    assert len(points) == pytest.approx(55.9, abs=1.1)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([], "empty"),
        ([(0.0, 1.0, 2.0)], r"shape is \(1, 3\)"),
        ([0.0, 1.0], r"shape is \(2,\)"),
        ([(0.0, 0.0), (math.nan, 0.0)], "point 1 is not finite"),
        ([(0.0, math.inf)], "point 0 is not finite"),
        ([(0.0, 0.0), (1.0, 0.0), (0.25, 0.0)], "x decreases from 1 to 0.25 m.* points 1 and 2"),
    ],
)
def test_a_profile_that_is_none_says_why(points: list, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Profile(points)


def test_a_profile_cannot_be_changed() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.2)])
    profile = Profile(points)
    points[1, 1] = 9.0  # the caller's array, not the profile's
    assert profile.height(1.0) == 0.2
    with pytest.raises(ValueError, match="read-only"):
        profile.points[0, 0] = 1.0


def test_action_index_is_3_i_plus_j_from_both_down_to_both_up() -> None:
    assert [action_index(i, j) for i, j in ACTIONS] == list(range(9))
    assert ACTIONS[0] == (-1, -1)
    assert ACTIONS[4] == (0, 0)
    assert ACTIONS[5] == (0, 1)
    assert ACTIONS[7] == (1, 0)
    assert ACTIONS[8] == (1, 1)


@pytest.mark.parametrize(("turns", "name"), [((0, 2), "rear"), ((-2, 0), "front"), ((0.5, 0), "")])
def test_a_turn_that_is_none_is_refused(turns: tuple[int, int], name: str) -> None:
    """It would be the index of another action."""
    with pytest.raises(ValueError, match=rf"{name}.* -1, 0 or 1 is allowed"):
        api.action_index(*turns)


def test_a_setting_cannot_be_set() -> None:
    with pytest.raises(AttributeError, match=r"Robot\.track_speed cannot be set: settings do not"):
        api.Robot().track_speed = 0.3


def test_lengths_of_the_robot_are_overall_lengths_of_capsules() -> None:
    robot = RobotGeometry()
    assert robot.hinge_offset == pytest.approx(0.28)  # 0.76 / 2 - 0.1
    assert robot.flipper_axle == pytest.approx(0.336)  # 0.536 - 2 · 0.1
    assert robot.clip(2.0) == -robot.clip(-2.0) == pytest.approx(math.pi / 3)
    assert robot.clip(0.5) == 0.5


def test_a_layout_knows_its_extent() -> None:
    for highest, heights in ((True, 10), (False, 5)):
        layout = ObservationLayout(bins=5, bin_width=0.2, highest=highest)
        assert (layout.heights, layout.size) == (heights, heights + 3)
        assert layout.reach == pytest.approx(0.5)  # 5 · 0.2 / 2
        assert layout.scale == pytest.approx([0.5] * heights + [math.pi / 3] * 3)


def test_ground_that_folds_back_is_refused() -> None:
    profile = Profile([(0.0, 0.0), (4.0, 1.0)])
    with pytest.raises(ValueError, match=r"level ground of -0\.2 m cannot be added"):
        profile.sample(0.02, -0.2)
