"""The axes of a map: settings, ranges, and what is refused."""

import pytest

from flipperctl.config import EvalConfig
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation.views.axes import grid_config, parse_axes

UPLIFT = EvalConfig(terrain="uplift")


def test_a_range_and_its_number_of_values() -> None:
    first, second = parse_axes("terrain.height=0.1:0.6:6,sim.friction=0.4:1.0:3", UPLIFT)
    assert first.keys == ("terrain.height_low", "terrain.height_high")
    assert first.values == (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    assert (first.label, second.label) == ("terrain.height [m]", "sim.friction")
    config = grid_config(UPLIFT, (first, second), (1, 2))
    assert (config.terrain.height_low, config.terrain.height_high) == (0.2, 0.2)
    assert config.sim.friction == 1.0


def test_settings_joined_by_a_plus_have_one_value_and_integers_stay_integers() -> None:
    config = EvalConfig(terrain="stair")
    axes = parse_axes("terrain.fewest+terrain.most=2:6,terrain.tread_down+terrain.tread", config)
    assert axes[0].values == (2, 3, 4, 5, 6)
    terrain = grid_config(config, axes, (4, 0)).terrain
    assert (terrain.fewest, terrain.most) == (6, 6)
    assert terrain.tread == terrain.tread_down == 0.15


def test_default_ranges_surround_the_value_within_the_bounds() -> None:
    friction, noise = parse_axes("sim.friction,perception.noise", UPLIFT)
    assert (friction.values[0], friction.values[-1], len(friction.values)) == (0.5, 1.5, 20)
    assert (noise.values[0], noise.values[-1]) == (0.0, 0.2)
    below, horizon = parse_axes("perception.dropout,perception.horizon", UPLIFT)
    assert below.values[-1] == 0.95  # 1 itself is not allowed
    assert (horizon.values[0], horizon.values[-1]) == (5.0, 10.0)


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("terrain.height", RequestError, "two settings are allowed"),
        ("terrain.hight,sim.friction", ConfigError, "did you mean 'terrain.height_low'"),
        ("perception.occlusion,sim.friction", ConfigError, "it is no number"),
        ("terrain.height,terrain.height_low", ConfigError, "stands in both axes"),
        ("terrain.height=1:0,sim.friction", RequestError, "from a lower to a higher number"),
        ("terrain.height=low:1,sim.friction", RequestError, "LOW:HIGH or LOW:HIGH:VALUES"),
        ("terrain.height=0.1:1:1.5,sim.friction", RequestError, "2 to 100 values"),
    ],
)
def test_axes_that_are_refused(text: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        parse_axes(text, UPLIFT)


def test_a_value_out_of_bounds_is_named() -> None:
    axes = parse_axes("terrain.height=0.1:2:2,sim.friction", UPLIFT)
    with pytest.raises(ConfigError, match=r"terrain\.height_low.*≤ 0.8.*2"):
        grid_config(UPLIFT, axes, (1, 0))


def test_a_setting_that_is_sampled_in_each_episode_is_refused() -> None:
    config = EvalConfig(terrain="uplift", randomise={"friction": [0.8, 1.2]})
    with pytest.raises(ConfigError, match=r"--over sim\.friction: it has no effect"):
        parse_axes("terrain.height,sim.friction", config)
