"""Terrains made of other terrains: inner plugins of any origin, their labels and their faces."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl import checkpoint
from flipperctl.api import Profile, Terrain, registry, terrain
from flipperctl.config import TrainConfig, resolver
from flipperctl.errors import ConfigError


@pytest.fixture
def spike() -> Iterator[type[Terrain]]:
    """Register a third party's terrain."""

    @terrain("spike")
    class Spike(Terrain):
        """A spike that begins low and ends high."""

        tall: float = 0.2

        def generate(self, rng: np.random.Generator) -> Profile:
            label = "tall spike" if rng.random() < 0.5 else ""
            return Profile([(2.0, 1.0), (3.0, 1.0 + self.tall)], label)

    yield Spike
    del registry["terrain", "spike"]


def made(name: str, **fields: Any) -> Terrain:
    found = resolver.create("terrain", {"name": name, **fields}, "terrain")
    assert isinstance(found, Terrain)
    return found


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


STEP = {"name": "step", "height": 0.3}


def test_what_is_made_of_a_recorded_file_has_its_name() -> None:
    file = {"name": "profile_file", "path": str(Path(__file__).with_name("curbs.csv"))}
    assert (
        made("mirror", terrain=made("noisy", terrain=file)).title == "mirror of noisy of curbs.csv"
    )
    assert (made("mirror").title, made("mix", parts=[file, "step"]).title) == ("mirror", "mix")


def test_a_mix_draws_by_weight_and_labels_the_profile(spike: type[Terrain]) -> None:
    mix = made("mix", parts=["flat", "spike", STEP], weights=[1, 2, 0])
    stream = rng()
    drawn = Counter(mix.labelled(stream).label for _ in range(600))
    assert set(drawn) == {"flat", "spike", "tall spike"}
    assert drawn["flat"] == pytest.approx(200, abs=40)


def test_a_sequence_continues_at_the_height_of_the_previous_part(spike: type[Terrain]) -> None:
    parts = [STEP, {"name": "spike", "tall": 0.5}, STEP]
    profile = made("sequence", parts=parts, spacing=0.5).labelled(rng(1))
    assert profile.label == "step+tall spike+step"
    assert profile.points == pytest.approx(
        np.array([(0, 0), (0, 0.3), (0.5, 0.3), (1.5, 0.8), (2.0, 0.8), (2.0, 1.1)])
    )


def test_a_mirror_reverses_a_terrain_with_its_probability(spike: type[Terrain]) -> None:
    mirror = made("mirror", terrain="spike")
    assert mirror.labelled(rng()).points == pytest.approx(np.array([(0, 0), (1, -0.2)]))
    never = made("mirror", terrain="spike", probability=0)
    assert never.labelled(rng()).points.tolist() == [[2.0, 1.0], [3.0, 1.2]]


def test_noise_keeps_the_direction_and_height_of_vertical_faces() -> None:
    stair = {"name": "stair", "steps": 3, "rise": 0.2, "direction": "up"}
    rough = made("noisy", terrain=stair, deviation=0.02).labelled(rng())
    faces = np.diff(rough.points, axis=0)
    assert faces[faces[:, 0] == 0, 1] == pytest.approx([0.2] * 3)
    plain = made("stair", **{k: v for k, v in stair.items() if k != "name"}).generate(rng())
    assert rough.start == pytest.approx(plain.start - 0.5)
    assert rough.end == pytest.approx(plain.end + 0.5)
    long = made("noisy", terrain={"name": "flat", "length": 50}, deviation=0.02, margin=0)
    assert long.generate(rng()).points[:, 1].std() == pytest.approx(0.02, rel=0.2)


@pytest.mark.parametrize(
    ("part", "text"),
    [
        ("stare", "terrain.parts.1: there is no terrain plugin 'stare' (did you mean 'stair'?"),
        ({"name": "stair", "rise": 9}, "terrain.parts.1.rise: "),
        ({"name": "stair", "ris": 1}, "terrain.parts.1.ris: there is no such key (did you mean 'r"),
        (
            {"name": "mirror", "terrain": {"name": "gap", "width_lo": 1}},
            "terrain.parts.1.terrain.width_lo: there is no such key (did you mean 'width'?",
        ),
        ({"rise": 1}, "terrain.parts.1: a terrain's name, or a mapping"),
    ],
)
def test_an_error_in_an_inner_terrain_names_its_place(part: object, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        made("mix", parts=["step", part])
    assert str(caught.value).startswith(text)


def test_a_checkpoint_names_the_plugins_within_the_terrain(spike: type[Terrain]) -> None:
    mirror = {"name": "mirror", "terrain": {"name": "spike", "tall": 0.1}}
    config = TrainConfig(terrain=made("mix", parts=["flat", mirror]), network="mlp")
    result = {"success_rate": 1.0, "t_cost": 9.0, "pitch_variation_decisions": 1.0}
    validation = {"decision": 5, "pitch_variation_100hz": 1.0, **result}
    document = checkpoint.describe(config, "best", decision=5, validation=validation)
    names = [p.name for p in document.plugins if p.kind == "terrain"]
    assert names == ["mix", "flat", "mirror", "spike"]
    terrain = document.config.terrain.model_dump()
    assert resolver.create("terrain", terrain, "terrain") == config.terrain


def test_a_curriculum_interpolates_each_number_from_easy_to_hard(spike: type[Terrain]) -> None:
    easy = {
        "name": "mix",
        "parts": [{"name": "spike", "tall": 0}, {"name": "wave", "waves": [2, 2]}],
    }
    hard = {
        "name": "mix",
        "parts": [{"name": "spike", "tall": 1}, {"name": "wave", "waves": [2, 8]}],
    }
    found = made("curriculum", easy=easy, hard=hard)
    between = {
        "name": "mix",
        "parts": [{"name": "spike", "tall": 0.25}, {"name": "wave", "waves": [2, 4]}],
    }
    assert found.at(0.25) == resolver.create("terrain", between, "terrain")
    assert found.at(0.0) == resolver.create("terrain", easy, "terrain")
    assert found.at(1.0) == resolver.create("terrain", hard, "terrain")


def test_a_curriculum_takes_steps_between_0_and_1() -> None:
    found = made("curriculum", start=0.5, up=0.3, down=0.4)
    assert found.first_difficulty == 0.5
    assert found.next_difficulty(0.5, True) == pytest.approx(0.8)
    assert found.next_difficulty(0.8, True) == 1.0
    assert found.next_difficulty(0.3, False) == 0.0
    mix = made("mix", parts=["flat", resolver.to_dict(found)])
    assert mix.first_difficulty == 0.5
    assert mix.next_difficulty(0.5, True) == pytest.approx(0.8)
    low = made("step", height=[-0.25, 0.25])
    assert mix.at(0.5) == made("mix", parts=["flat", resolver.to_dict(low)])


@pytest.mark.parametrize(
    ("hard", "text"),
    [
        ({"name": "stair"}, "step and stair"),
        ({"name": "step", "platform": 1, "back": True}, "step.back is False and True"),
    ],
)
def test_only_numbers_may_differ_between_easy_and_hard(hard: object, text: str) -> None:
    with pytest.raises(ConfigError, match=f"only numbers may differ.*{text}"):
        made("curriculum", hard=hard)
