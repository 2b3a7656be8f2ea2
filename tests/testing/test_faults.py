"""The faults that the conformance suite finds in engines, sensors, networks and controllers."""

import json
import runpy
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl import api
from flipperctl.api import Controller, Network, Profile
from flipperctl.core.sensing import SensedAngles, SensedGround
from flipperctl.testing import checks, policies
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


SIZE = api.ObservationLayout().size


class Linear(torch.nn.Linear):
    """A linear layer from the numbers of an observation to 9 Q-values."""

    def __init__(self, change: Callable[["Linear", torch.Tensor], torch.Tensor]) -> None:
        super().__init__(SIZE, 9)
        self.change = change

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return self.change(self, observation)


def network(change: Callable[[Linear, torch.Tensor], torch.Tensor]) -> type[Network]:
    class Mine(Network):
        """A network without fields."""

        def build(self, layout: api.ObservationLayout, n_actions: int) -> torch.nn.Module:
            return Linear(change)

    return Mine


def plain(module: torch.nn.Linear, x: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.linear(x, module.weight, module.bias)


@pytest.mark.parametrize(
    ("check", "change", "words"),
    [
        ("shape", plain, ["bins=3", "(2, 9)"]),
        ("gradient", lambda m, x: plain(m, x) - m.bias, ["'bias'", "0 everywhere"]),
        ("gradient", lambda m, x: plain(m, x * (torch.arange(SIZE) > 1)), ["'", "[0, 1]"]),
        ("repeats", lambda m, x: plain(m, x) + torch.rand(9), ["in eval mode"]),
        ("onnx", lambda m, x: plain(m, x) if x.sum() > 0 else x[:, :9], ["cannot export"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_network_that_fails_is_described(
    check: str, change: Callable[[Linear, torch.Tensor], torch.Tensor], words: list[str]
) -> None:
    text = failure(network(change), check)
    assert [word for word in words if word not in text] == [], text


def driving(act: Callable[[api.Perception], object]) -> type[Controller]:
    class Mine(Controller):
        """A rule without fields."""

        def act(self, p: api.Perception) -> int:
            return act(p)

    return Mine


@pytest.mark.parametrize(
    ("check", "act", "words"),
    [
        ("actions", lambda p: 9 if p.pitch > 0.2 else 4, ["returned 9", "0 to 8"]),
        ("actions", lambda p: np.float64(4), ["4.0"]),
        (
            "repeats",
            lambda p: int(np.random.default_rng().integers(9)),
            ["random numbers from p.rng"],
        ),
        ("in time", lambda p: 4, ["1.00 s", "after 0.6 s"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_controller_that_fails_is_described(
    check: str,
    act: Callable[[api.Perception], object],
    words: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seconds = iter(range(10_000))
    monkeypatch.setattr(policies, "ENOUGH", 1e9)
    monkeypatch.setattr(policies, "perf_counter", lambda: float(next(seconds)))
    text = failure(driving(act), check)
    assert [word for word in words if word not in text] == [], text


@pytest.mark.usefixtures("registry")
def test_a_policy_that_does_not_forget_its_episode_is_described() -> None:
    class Leaky:
        def __init__(self) -> None:
            self.made = 0

        def reset(self, simulator: api.Simulator) -> None: ...

        def act(self, p: api.Perception) -> int:
            self.made += 1
            return 8 if self.made <= 3 else 4

    class Mine(Controller):
        """A rule that raises the flippers in the first three decisions."""

        def build(self) -> api.Policy:
            return Leaky()

    assert "by the same policy, whose reset must forget the first" in failure(Mine, "repeats")
