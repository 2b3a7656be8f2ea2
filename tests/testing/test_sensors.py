"""Faults of sensors with instruments, which the conformance suite describes."""

import functools
import json
from dataclasses import dataclass

import numpy as np
import pytest

from flipperctl import api
from flipperctl.core.sensing import SensedAngles, SensedGround
from flipperctl.testing.sensor import foreign_names
from tests.testing.failing import failure


class Counter(api.Instrument):
    """An instrument that counts, and whose memory no snapshot holds."""

    period = 0.1
    count = 0

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> object:
        self.count += 1
        return Count(self.count)


@dataclass(frozen=True)
class Count:
    number: int


class Level:
    """An estimator of level ground, whose pitch is what it received last."""

    pitch = 0.0

    def update(self, measured: api.Measured) -> None:
        self.pitch = float(getattr(measured.value, "number", 0.0))

    def estimate(self, time: float) -> tuple[api.SensedGround, api.SensedAngles]:
        ground = SensedGround(np.zeros((2, 2)))
        return ground, SensedAngles(front=0.0, rear=0.0, pitch=self.pitch)

    def save(self) -> float:
        return self.pitch

    def load(self, saved: float) -> None:
        self.pitch = saved


class Contract(Level):
    """An estimator that a robot cannot import."""

    def save(self) -> float:
        return self.pitch if api.SAMPLE_PERIOD else json.loads("0")


class Loose(Counter):
    """An instrument whose measurement can be changed."""

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> object:
        return [3]


class Drawn(Counter):
    """An instrument that draws from another generator."""

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> object:
        return Count(int(np.random.default_rng().integers(10**9)))


def sensing(instrument: type[api.Instrument], estimator: type[Level]) -> type[api.Sensor]:
    class Mine(api.Sensor):
        """A sensor without fields."""

        def instruments(self, mounting: api.Mounting) -> dict[str, api.Instrument]:
            return {"counter": instrument()}

        def estimator(self, robot: api.RobotGeometry) -> api.Estimator:
            return estimator()

    return Mine


@pytest.mark.parametrize(
    ("check", "instrument", "estimator", "words"),
    [
        ("episodes", Loose, Level, ["'counter' returned [3]", "frozen dataclass"]),
        ("episodes", Drawn, Level, ["unequal perceptions"]),
        ("returns", Counter, Level, ["after its snapshot is loaded", "save and load"]),
        ("portable", Counter, Contract, ["Contract uses flipperctl.api;", "numpy"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_sensor_that_fails_is_described(
    check: str, instrument: type[api.Instrument], estimator: type[Level], words: list[str]
) -> None:
    text = failure(sensing(instrument, estimator), check)
    assert [word for word in words if word not in text] == [], text


@functools.cache
def cached_layout() -> object:
    return api.ObservationLayout()


class Caching:
    """Parts that wrap their functions, each of which needs more than numpy."""

    @functools.cached_property
    def held(self) -> object:
        return api.ObservationLayout()

    part = functools.partialmethod(lambda self: api.ObservationLayout())


class Calling:
    def act(self) -> object:
        return cached_layout()


@pytest.mark.parametrize("wrapped", [Caching.held, vars(Caching)["part"], Calling.act])
def test_what_a_cache_or_a_partial_wraps_is_looked_into(wrapped: object) -> None:
    cls = type("Estimator", (), {"held": wrapped, "__module__": __name__})
    assert "flipperctl.api" in foreign_names(cls)
