"""From names and overrides to settings: every way in gives the same settings, or the same words."""

import pytest

from flipperctl.config import (
    EnvConfig,
    RayCollector,
    Teacher,
    TrainConfig,
    parse,
    resolver,
    to_dict,
    with_overrides,
)
from flipperctl.errors import ConfigError


def test_an_unknown_name_gives_a_close_match_and_all_that_is_registered() -> None:
    with pytest.raises(ConfigError) as error:
        resolver.get("terrain", "stairs", "terrain")
    assert str(error.value).startswith("terrain: there is no terrain plugin 'stairs'")
    assert "did you mean 'stair'?" in str(error.value)
    assert "paper_step" in str(error.value)


@pytest.mark.parametrize("settings", [3, None, {}, {"rise": 0.1}])
def test_settings_without_a_name_are_an_error(settings: object) -> None:
    with pytest.raises(ConfigError, match="terrain: a plugin's name, or a mapping with 'name'"):
        resolver.create("terrain", settings, "terrain")


def test_a_plugins_container_makes_an_equal_plugin() -> None:
    mix = resolver.create("terrain", {"name": "mix", "parts": ["flat", "step"]}, "terrain")
    assert resolver.create("terrain", to_dict(mix), "terrain") == mix
    assert to_dict(mix, brief=True)["parts"] == ["flat", "step"]
    assert [p.plugin_name for p in resolver.nested_plugins(mix)] == ["mix", "flat", "step"]


def test_a_name_inside_a_plugin_is_refused_in_the_words_of_one_outside() -> None:
    with pytest.raises(ConfigError) as outside:
        resolver.create("terrain", "stiar", "terrain.parts.0")
    with pytest.raises(ConfigError) as inside:
        resolver.create("terrain", {"name": "mix", "parts": ["stiar"]}, "terrain")
    assert str(inside.value) == str(outside.value)


def test_nested_and_dotted_overrides_and_a_whole_container_make_the_same_settings() -> None:
    base = EnvConfig(terrain="stair")
    dotted = with_overrides(base, {"terrain.rise": 0.1, "rewards.pitch.window": 4})
    nested = with_overrides(base, {"terrain": {"rise": 0.1}, "rewards": {"pitch": {"window": 4}}})
    assert dotted == nested == parse(EnvConfig, to_dict(nested))
    assert dotted != base


def test_overrides_drop_terms_and_add_others() -> None:
    base = EnvConfig(terrain="stair")
    found = with_overrides(base, {"rewards.pitch": None, "rewards.hit": "impact"})
    assert set(found.rewards) == {"flipper", "end", "hit"}
    assert with_overrides(base, {"rewards": {}}).rewards == {}


def test_a_collector_may_be_named_alone() -> None:
    base = TrainConfig(terrain="stair", network="at_d3qn")
    found = with_overrides(base, {"collector": "ray", "collector.workers": 3})
    assert found.collector == RayCollector(workers=3)
    assert with_overrides(found, {"collector": "local"}).collector == base.collector
    later = with_overrides(base, {"collector.workers": 3, "collector": "ray"})
    assert later.collector == found.collector  # in any order
    kept = with_overrides(found, {"collector": "ray", "collector.patience": 9})
    assert kept.collector == RayCollector(workers=3, patience=9)


@pytest.mark.parametrize(
    "named",
    [
        {"sim": "mujoco"},
        {"sim": {"name": "mujoco"}},
        {"robot": "absolem"},
        {"perception": "lidar"},
    ],
)
def test_fields_of_what_is_named_count_in_any_order(named: dict[str, object]) -> None:
    fields = {"sim": "friction", "robot": "track_speed", "perception": "delay"}
    (section,) = named
    field = f"{section}.{fields[section]}"
    base = EnvConfig(terrain="stair")
    found = [
        with_overrides(base, {**first, **then})
        for first, then in ((named, {field: 0.31}), ({field: 0.31}, named))
    ]
    assert found[0] == found[1] != with_overrides(base, named)
    assert getattr(getattr(found[0], section), fields[section]) == 0.31


def test_an_override_inside_a_value_names_the_value() -> None:
    with pytest.raises(ConfigError, match=r"terrain\.rise\.x: rise is a value, not a section"):
        with_overrides(EnvConfig(terrain="stair"), {"terrain.rise.x": 1})


@pytest.mark.parametrize("kind", ["sim", "perception"])
def test_an_engine_that_is_not_found_may_need_a_reinstall(kind: str) -> None:
    with pytest.raises(ConfigError, match=r"reinstalled \(pip install -e \.\)"):
        resolver.create(kind, "mine", kind)
    with pytest.raises(ConfigError) as error:
        resolver.create("terrain", "mine", "terrain")
    assert "reinstalled" not in str(error.value)


@pytest.mark.parametrize("name", ["temperature", "q_temperature"])
def test_a_teacher_s_temperature_that_overflows_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"{name}: .* greater than or equal to 0.000001"):
        parse(Teacher, {name: 1e-323})
