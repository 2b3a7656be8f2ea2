"""Pictures and films of episodes whose sensor maps the ground."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from flipperctl.api import Profile, Robot, Transition
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.figures.episode import episode_figure, map_points, mapped
from flipperctl.figures.film import save_film


@pytest.fixture(scope="module")
def driven() -> tuple[list[Transition], Profile]:
    env = FlipperEnv("step", perception={"name": "lidar", "azimuths": 60})
    env.reset(seed=1)
    made = []
    for _ in range(3):
        env.step(4)
        made.append(env.transition)
    return made, env.profile


def test_the_points_of_the_map_lie_on_the_ground_and_filled_ones_are_left_out(
    driven: tuple[list[Transition], Profile],
) -> None:
    made, profile = driven
    (p, *_) = mapped(made)
    points = map_points(p, made[0].before.position)
    assert p.filled is not None
    assert len(points) == np.count_nonzero(~p.filled) < len(p.points)
    before = points[points[:, 0] < profile.start - 0.1]
    assert len(before) > 10
    assert np.abs(before[:, 1] - profile.height(profile.start - 1)).max() < 0.06


def test_the_picture_has_the_map_and_the_heights_over_time(
    driven: tuple[list[Transition], Profile],
) -> None:
    made, profile = driven
    states = [made[0].before, *(t.after for t in made)]
    figure = episode_figure(states, profile, Robot(), "", mapped(made))
    above, below, lowest, _ = figure.axes  # the last one is the bar of colours
    (shown,) = (line for line in above.get_lines() if line.get_label() == "map")
    assert len(np.asarray(shown.get_xdata())) > 100
    assert lowest.get_xlim() == below.get_xlim()
    (mesh,) = lowest.collections
    heights = np.ma.filled(np.ma.masked_invalid(np.asarray(mesh.get_array())), np.nan)
    first = made[0].perception
    assert first is not None
    assert first.seen is not None
    assert heights.reshape(15, 3)[first.seen, 0] == pytest.approx(
        first.observation[:15][first.seen]
    )
    assert np.isnan(heights.reshape(15, 3)[~first.seen, 0]).all()


def test_a_film_draws_the_map_only_if_the_sensor_has_one(
    driven: tuple[list[Transition], Profile], tmp_path: Path
) -> None:
    made, profile = driven
    assert mapped([replace(t, perception=None) for t in made]) == []
    pictures = []
    for name, transitions in (("a", made), ("b", [replace(t, perception=None) for t in made])):
        save_film(tmp_path / f"{name}.gif", transitions[:1], profile, Robot(), speed=0.2)
        with Image.open(tmp_path / f"{name}.gif") as film:
            pictures.append(np.array(film.convert("RGB")))
    assert (pictures[0] != pictures[1]).any()
