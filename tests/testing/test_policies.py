"""The faults that the conformance suite finds in networks and controllers."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from flipperctl import api
from flipperctl.api import Controller, Network
from flipperctl.testing import policies
from tests.testing.failing import failure

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
        ("repeats", lambda m, x: plain(m, x) - plain(m, x).mean(), ["alone than in a batch"]),
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
