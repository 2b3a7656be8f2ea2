"""A film of an episode."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from flipperctl.api import Profile, Robot, RobotState, Transition
from flipperctl.errors import OutputError
from flipperctl.figures.film import check_film, instants, samples, save_film

STEP = Profile([(0.0, 0.0), (0.0, 0.2), (0.5, 0.2)])


def state(x: float, front: float, time: float) -> RobotState:
    return RobotState(np.array([x, 0.1]), 0.0, front, 0.0, np.array([0.2, 0.0]), 0.0, time)


def drive(decisions: int) -> list[Transition]:
    """A robot at 0.2 m/s whose front flippers rise by 0.3 rad in each decision of 0.6 s."""
    made = []
    for n in range(decisions):
        before, after = (state(0.12 * k - 1, 0.3 * k, 0.6 * k) for k in (n, n + 1))
        x = np.linspace(before.position[0], after.position[0], 61)
        path = np.column_stack([x, np.full(61, 0.1), np.zeros(61)])
        flippers = np.column_stack([np.linspace(before.front, after.front, 61), np.zeros(61)])
        pitches = np.zeros(n + 2)
        made.append(
            Transition(before, after, pitches, (1, 0), STEP, Robot(), None, path, flippers=flippers)
        )
    return made


def test_the_instants_are_evenly_spaced_over_decisions_and_include_the_end() -> None:
    shown = list(instants(drive(2), 0.25))
    assert [s.time for s in shown] == pytest.approx([0, 0.25, 0.5, 0.75, 1, 1.2])
    assert [s.position[0] for s in shown] == pytest.approx([-1, -0.95, -0.9, -0.85, -0.8, -0.76])
    assert [s.front for s in shown] == pytest.approx([0, 0.125, 0.25, 0.375, 0.5, 0.6])


def test_a_film_moves_lasts_as_long_as_it_says_and_is_equal_for_equal_episodes(
    tmp_path: Path,
) -> None:
    paths = [tmp_path / "one.gif", tmp_path / "two.gif"]
    done: list[float] = []
    for path in paths:
        save_film(path, drive(2), STEP, Robot(), "a rule on step", done.append, speed=0.2)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    check_film(paths[0])  # a film of before is replaced
    assert done[-1] == 1
    with Image.open(paths[0]) as film:
        assert film.n_frames == 11  # every 0.12 s of 1.2 s, the start and the end
        assert film.info["loop"] == 0
        first = np.array(film.convert("RGB"))
        assert film.info["duration"] == 40  # a third of 0.12 s
        film.seek(10)
        last = np.array(film.convert("RGB"))
    assert first.shape == last.shape
    assert (first != last).any()


def test_decisions_without_poses_are_shown_at_their_starts() -> None:
    made = [replace(t, path=np.empty((0, 3)), flippers=np.empty((0, 2))) for t in drive(3)]
    assert [s.time for s in samples(made)] == pytest.approx([0, 0.6, 1.2, 1.8])


def test_the_clock_is_whole_above_a_tall_picture(tmp_path: Path) -> None:
    high = Profile([(0.0, 0.0), (0.0, 2.0), (0.5, 2.0)])
    save_film(tmp_path / "tall.gif", drive(8), high, Robot(), speed=0.2)
    with Image.open(tmp_path / "tall.gif") as film:
        first = np.array(film.convert("L"))
    assert (first[:3] > 200).all()
    assert (first[:25, first.shape[1] // 2 :] < 100).any()  # the clock


@pytest.mark.parametrize("name", ["film.mp4", "film", "missing/film.gif"])
def test_a_film_that_cannot_be_written_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"film"):
        check_film(tmp_path / name)


def test_a_film_needs_a_transition(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at least one"):
        save_film(tmp_path / "film.gif", [], STEP, Robot(), speed=0.2)
