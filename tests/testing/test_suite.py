"""The faults that the conformance suite finds, and the messages that an author reads."""

import unittest
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from pydantic import Field

from flipperctl import api
from flipperctl.api import Outcome, Profile, RewardTerm, Terrain
from flipperctl.config import TrainConfig
from flipperctl.errors import ConformanceError, MissingExtraError, PluginFailedError, TerrainError
from flipperctl.export import policy as export_policy
from flipperctl.plugging import plugins
from flipperctl.testing import Conformance, NotChecked, checks
from flipperctl.testing.check import variants
from flipperctl.testing.recorded import transitions, transitions_in_arrays
from flipperctl.training.run import check
from tests.testing.failing import failure

Draw = Callable[[float, np.random.Generator], object]


class TestInherited(Conformance):
    """The test class of the tutorial."""

    plugin = api.registry["terrain", "flat"]


def terrain(draw: Draw) -> type[Terrain]:
    class Mine(Terrain):
        """A terrain with one field."""

        height: float = Field(0.2, ge=0, le=0.4, description="height [m]")

        def generate(self, rng: np.random.Generator) -> Profile:
            return draw(self.height, rng)

    return Mine


def box(height: float, length: float = 1.0) -> Profile:
    return Profile([(0, 0), (0, height), (length, height)])


def level(points: int) -> Profile:
    return Profile(np.stack([np.linspace(0, 1, points), np.zeros(points)], axis=1))


def reset(rng: np.random.Generator) -> Profile:
    rng.bit_generator.state = np.random.default_rng(0).bit_generator.state
    return box(rng.uniform(0.1, 0.2))


@pytest.mark.parametrize(
    ("check", "draw", "words"),
    [
        ("profiles", lambda h, rng: [(0, 0)], ["with its defaults", "returns a list", "Profile"]),
        ("profiles", lambda h, rng: box(1 / (0.4 - h)), ["with height=0.4", "ZeroDivisionError"]),
        ("profiles", lambda h, rng: box(np.random.default_rng().random()), ["must come from rng"]),
        ("profiles", lambda h, rng: box(h, 500 * h + 1), ["101 m long", "at most 100 m", "=0.4"]),
        ("profiles", lambda h, rng: level(200_000), ["200,000 points", "at most 100,000"]),
        ("varies", lambda h, rng: reset(rng), ["unequal seeds in equal states"]),
        ("start", lambda h, rng: box(400.0), ["400 m above or below", "at most 100 is allowed"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_terrain_that_fails_is_described(check: str, draw: Draw, words: list[str]) -> None:
    text = failure(terrain(draw), check)
    assert text.startswith("terrain 'mine' with ")
    assert [word for word in words if word not in text] == [], text


@pytest.mark.usefixtures("registry")
def test_a_difficulty_stays_between_0_and_1() -> None:
    class Harder(terrain(lambda h, rng: box(h))):
        """A terrain whose difficulty doubles each time."""

        def next_difficulty(self, difficulty: float, reached: bool) -> float:
            return 2 * difficulty

    assert "difficulty 1 leads to 2; 0 to 1 is allowed" in failure(Harder, "difficulty")


@pytest.mark.usefixtures("registry")
def test_a_sampled_ground_varies() -> None:
    class Mine(Terrain):
        """A terrain that draws its height from a generator of its own."""

        height: api.Range = Field(api.Range(0.1, 0.2), ge=0, le=1, description="height [m]")

        def generate(self, rng: np.random.Generator) -> Profile:
            return box(self.height.sample(np.random.default_rng(0)))

    assert "the same for 25 seeds, although height is sampled" in failure(Mine, "varies")


@pytest.mark.parametrize(
    ("height", "words"),
    [
        (-5.0, ["at returned settings that are not allowed: height", "-5.0 is not allowed"]),
        ("0.2", ["at returned Mine(height='0.2'); its settings, validated, are Mine(height=0.2)"]),
        (0.3, ["at(1) has other ground than the terrain itself"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_what_a_curriculum_returns_is_validated(height: object, words: list[str]) -> None:
    class Mine(terrain(lambda h, rng: box(float(h)))):
        """A terrain that is copied past its validation."""

        def at(self, difficulty: float) -> Terrain:
            return self.model_copy(update={"height": height})

    Mine.__name__ = Mine.__qualname__ = "Mine"
    text = failure(Mine, "difficulty")
    assert [word for word in words if word not in text] == [], text
    with pytest.raises((TerrainError, PluginFailedError), match=r"terrain 'mine'.* at "):
        check(TrainConfig(terrain=Mine(), network="mlp"))  # the start of a training


ELSEWHERE = """
import os
from flipperctl.api import Profile, Terrain, terrain
first = []

@terrain("by_process")
class ByProcess(Terrain):
    def generate(self, rng):
        return Profile([(0, 0), (0.5, 0.1 + os.getpid() * 1e-8), (1, 0)])

@terrain("by_hash")
class ByHash(Terrain):
    def generate(self, rng):
        return Profile([(0, 0), (0.5, 0.1 + hash("a") % 1000 * 1e-5), (1, 0)])

@terrain("by_memory")
class ByMemory(Terrain):
    def generate(self, rng):
        first.append(rng.uniform(0.1, 0.2))
        return Profile([(0, 0), (0.5, first[0]), (1, 0)])
"""


@pytest.mark.usefixtures("registry")
def test_ground_of_another_process_is_equal(tmp_path: Path) -> None:
    (tmp_path / "elsewhere.py").write_text(ELSEWHERE)
    plugins.load([tmp_path / "elsewhere.py"])
    for name in ("by_process", "by_hash", "by_memory"):
        found = checks(api.registry["terrain", name])
        (elsewhere,) = (c for c in found if c.name == "another process")
        with pytest.raises(ConformanceError, match="ground with seed 0 differs in another process"):
            elsewhere()


def rewarding(pay: Callable[[api.Transition], object]) -> type[RewardTerm]:
    class Mine(RewardTerm):
        """A term without fields."""

        bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

        def __call__(self, t: api.Transition) -> float:
            return pay(t)

    return Mine


calls: list[int] = []


@pytest.mark.parametrize(
    ("check", "pay", "words"),
    [
        ("finite", lambda t: np.nan if t.outcome is Outcome.STUCK else 0.0, ["(stuck)", "nan"]),
        ("finite", lambda t: 0, ["(running)", "returns 0", "finite float"]),
        ("bounded", lambda t: -2.0 if t.outcome is Outcome.OVERTURNED else 0.0, ["-2", "-1 to 0"]),
        ("pure", lambda t: calls.append(1) or -float(len(calls)), ["called again"]),
        ("pure", lambda t: t.pitches.fill(7.0) or 0.0, ["read-only"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_reward_that_fails_is_described_with_the_outcome(
    check: str, pay: Callable[[api.Transition], object], words: list[str]
) -> None:
    transitions.cache_clear()
    text = failure(rewarding(pay), check)
    transitions.cache_clear()
    assert [word for word in words if word not in text] == [], text


@pytest.mark.parametrize(
    ("form", "words"),
    [
        (lambda ts: -np.abs(ts.after.pitch) - 1e-6, ["array returns -", "__call__ -", "1e-09"]),
        (lambda ts: np.zeros((len(ts), 1)), ["one of float64 and shape (", "floats of shape ("]),
        (lambda ts: -np.abs(ts.after.pitch, out=ts.after.pitch), ["changes the transitions"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_an_array_form_that_differs_is_described(
    form: Callable[[api.Transitions], object], words: list[str]
) -> None:
    class Mine(RewardTerm):
        """A term with an array form."""

        def __call__(self, t: api.Transition) -> float:
            return -abs(t.after.pitch)

        def array(self, ts: api.Transitions) -> object:
            return form(ts)

    transitions_in_arrays.cache_clear()
    text = failure(Mine, "arrays")
    transitions_in_arrays.cache_clear()
    assert [word for word in words if word not in text] == [], text


def test_every_outcome_is_recorded() -> None:
    assert {t.outcome for t in transitions()} == {None, *Outcome}


def described(**field: object) -> type[Terrain]:
    class Mine(Terrain):
        """A terrain."""

        height: float = Field(0.2, **field)

        def generate(self, rng: np.random.Generator) -> Profile:
            return box(self.height)

    return Mine


@pytest.mark.parametrize(
    ("check", "field", "words"),
    [
        ("documented", {"ge": 0, "le": 1, "description": "height"}, ["'height'", "unit", "[m]"]),
        ("documented", {"ge": 0, "description": "height [m]"}, ["'height'", "le= or lt="]),
        (
            "checkpoint",
            {"ge": 0, "le": 1, "exclude": True},
            ["height=0", "changes in a checkpoint"],
        ),
        ("checkpoint", {"gt": 0.2, "le": 1}, ["with its defaults: height", "greater than 0.2"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_fields_are_documented_and_kept(
    check: str, field: dict[str, object], words: list[str]
) -> None:
    text = failure(described(**field), check)
    assert [word for word in words if word not in text] == [], text


def test_variants_are_the_bounds_and_choices_that_the_validators_allow() -> None:
    labels = [v.label for v in variants(api.registry["terrain", "stair"], {})]
    assert labels[0] == "its defaults"
    assert {"rise=0.5", "rise=5e-324", "tread=2", "steps=50", "direction=up"} <= set(labels)
    assert "back=True" not in labels  # without a platform, it is refused


def test_without_its_packages_the_export_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise MissingExtraError(f"export onnx needs the package {name}; pip install {name}")

    monkeypatch.setattr(export_policy, "_import_package", missing)
    (onnx,) = [c for c in checks(api.registry["network", "mlp"]) if c.name == "onnx"]
    assert issubclass(NotChecked, unittest.SkipTest)  # which pytest shows as skipped
    with pytest.raises(NotChecked, match="pip install onnx"):
        onnx()
