"""Settings that are ranges: how they are written, their bounds, and samples from them."""

import pickle
from typing import Any

import numpy as np
import pytest
from pydantic import Field, ValidationError

from flipperctl.api import IntRange, Range, Settings
from flipperctl.config import resolver
from flipperctl.config.identity import identity


class Hurdles(Settings):
    height: Range = Field(Range(0.1, 0.3), gt=0, le=0.8)
    count: IntRange = Field(IntRange(2, 4), ge=1, le=9)
    lean: Range | None = Field(None, ge=-30, le=30)


def test_a_range_is_two_numbers_or_one_and_is_written_as_a_list() -> None:
    found = Hurdles(height=0.2, count=[3, 3], lean=(-5, 10))
    assert (found.height, found.count, found.lean) == ((0.2, 0.2), (3, 3), (-5, 10))
    assert found.model_dump_json() == '{"height":[0.2,0.2],"count":[3,3],"lean":[-5.0,10.0]}'
    assert Hurdles.model_validate_json(found.model_dump_json()) == found
    assert Hurdles(**dict(found)) == pickle.loads(pickle.dumps(found)) == found
    assert type(found.count) is IntRange


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"height": [0, 0.2]}, "greater than 0"),
        ({"lean": -31}, "greater than or equal to -30"),
        ({"height": [0.3, 0.1]}, "with low ≤ high"),
        ({"height": [0.1, 0.2, 0.3]}, "with low ≤ high, or one number"),
        ({"height": True}, "with low ≤ high, or one number"),
        ({"height": [0.1, True]}, "not true or false"),
        ({"height": float("nan")}, "finite"),
        ({"height": 10**400}, "valid number"),
        ({"count": 2.5}, "valid integer"),
    ],
)
def test_other_values_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ValidationError, match=text):
        Hurdles(**given)


def test_samples_are_uniform_and_integers_include_both_ends() -> None:
    rng, same = np.random.default_rng(3), np.random.default_rng(3)
    assert Range(0.1, 0.3).sample(rng) == same.uniform(0.1, 0.3)
    counts = [IntRange(2, 4).sample(rng) for _ in range(300)]
    assert counts == [same.integers(2, 5) for _ in range(300)]
    assert {2, 3, 4} == set(counts)


def test_the_episodes_of_an_evaluation_are_those_that_both_ends_had_as_settings() -> None:
    step = resolver.create("terrain", {"name": "step", "height": 0.4}, "terrain")
    assert identity(step) == {"name": "step", "settings": {"low": 0.4}}
    stairs = {"name": "stairwell", "steps": [3, 9], "flights": 2, "slope": [20, 30]}
    found = identity(resolver.create("terrain", stairs, "terrain"))["settings"]
    assert found == {"most": 9, "flights_high": 2, "slope_high": 30.0}
