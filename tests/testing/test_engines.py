"""The faults that the conformance suite finds in engines."""

import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import api
from flipperctl.api import Profile
from flipperctl.testing import checks
from tests.testing.failing import failure

KINEMATIC = Path(__file__).parents[2] / "examples" / "kinematic.py"


def forgetful(base: Any) -> Any:
    class World(base):
        def load(self, saved: Any) -> None:
            targets = self._targets
            super().load(saved)
            self._targets = targets

    return World


def limitless(base: Any) -> Any:
    class World(base):
        def advance(self, samples: int, limits: api.Limits = api.NO_LIMITS) -> api.FloatArray:
            found: api.FloatArray = super().advance(samples, api.Limits(x=limits.x))
            return found

    return World


def deaf(base: Any) -> Any:
    class World(base):
        def __init__(self, profile: Profile, robot: object, start: api.Start, *rest: Any) -> None:
            super().__init__(profile, api.Robot(), api.Start(start.x), *rest)

    return World


@pytest.mark.parametrize(
    ("change", "check", "words"),
    [
        (lambda base: base, "", ""),
        (forgetful, "returns", "after load, the robot goes on to"),
        (limitless, "stops", "not until the first one that reaches"),
        (deaf, "drives", "of a robot with track_speed=0.4"),
        (deaf, "end stops", "that the start has at"),
    ],
)
@pytest.mark.usefixtures("registry")
def test_an_engine_that_fails_is_described(
    change: Callable[[Any], Any], check: str, words: str
) -> None:
    world = change(runpy.run_path(str(KINEMATIC))["Sliding"])

    class Mine(api.Engine):
        """An engine without fields."""

        def place(self, profile: Profile, robot: api.Robot, start: api.Start, rng: Any) -> Any:
            return world(profile, robot, start, 0.5)

    if check:
        assert words in failure(Mine, check)
        return
    Mine.plugin_name = "mine"
    api.registry["sim", "mine"] = Mine
    for one in checks(Mine):
        if one.name in ("returns", "stops", "drives", "end stops", "repeats"):
            one()
