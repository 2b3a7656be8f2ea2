"""What every registered plugin must keep to, at its defaults and at each field's bounds."""

import inspect
import math
import re
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from flipperctl import plugins
from flipperctl.api import (
    ACTIONS,
    Controller,
    Network,
    ObservationLayout,
    Outcome,
    Perception,
    Plugin,
    Profile,
    RewardTerm,
    Terrain,
    Transition,
    registry,
)
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv


def edges(cls: type[Plugin], field: str) -> Iterator[float]:
    """The outermost values that the bounds of a field allow."""
    info = cls.model_fields[field]
    whole = info.annotation is int
    for bound in info.metadata:
        for name, way in (("ge", 0), ("le", 0), ("gt", 1), ("lt", -1)):
            value = getattr(bound, name, None)
            if value is None:
                continue
            yield value + way if whole else math.nextafter(value, value + way)


def at_bounds(kind: str) -> list[Any]:
    """An instance of each plugin at its defaults, and one for each bound of each field.

    A bound that does not go with the other fields' defaults (the plugin says so) gives none.
    """
    found = []
    for (family, name), cls in sorted(registry.items()):
        if family != kind:
            continue
        found.append(pytest.param(cls(), id=name))
        for field in cls.model_fields:
            for value in edges(cls, field):
                try:
                    found.append(pytest.param(cls(**{field: value}), id=f"{name}-{field}={value}"))
                except ValidationError as error:
                    if error.errors()[0]["type"] != "value_error":
                        raise
    return found


LAYOUTS = [pytest.param(ObservationLayout(bins=n), id=f"{n} bins") for n in (3, 15)]
KINDS = ("terrain", "reward", "network", "controller")
CLASSES = [pytest.param(cls, id=f"{kind}-{name}") for (kind, name), cls in sorted(registry.items())]


class Recorder(RewardTerm):
    """Keeps every transition that it is shown."""

    plugin_name: ClassVar[str] = "recorder"
    seen: ClassVar[list[Transition]] = []

    def __call__(self, t: Transition) -> float:
        """Nothing."""
        self.seen.append(t)
        return 0.0


@pytest.fixture(scope="module")
def episodes() -> tuple[list[Perception], list[Transition]]:
    """What the robot perceives and does on the built-in stair and step, to the ends."""
    perceptions = []
    Recorder.seen.clear()
    for name, driver in (("stair", "random"), ("step", "okada"), ("paper_stair", "okada")):
        rule = plugins.create("controller", driver, "controller")
        env = FlipperEnv(config=EnvConfig(terrain=name, rewards={"recorder": Recorder()}))
        env.reset(seed=0)
        over = False
        while not over:
            perceptions.append(env.perception)
            *_, terminated, truncated, _ = env.step(rule.act(env.perception))
            over = terminated or truncated
    return perceptions, list(Recorder.seen)


def test_every_family_has_its_plugins() -> None:
    assert {kind for kind, _ in registry} == set(KINDS)
    assert all(len(at_bounds(kind)) > len(plugins.names(kind)) for kind in KINDS[:3])


@pytest.mark.parametrize("cls", CLASSES)
def test_a_plugin_says_what_it_is_and_what_its_fields_are(cls: type[Plugin]) -> None:
    assert inspect.cleandoc(cls.__doc__ or "").strip()
    for name, field in cls.model_fields.items():
        assert re.search(r"\S \[[^\[\]]+\]$", field.description or ""), f"{name}: no unit"


@pytest.mark.parametrize("plugin", [p for kind in KINDS for p in at_bounds(kind)])
def test_a_plugin_survives_its_way_through_a_checkpoint(plugin: Plugin) -> None:
    again = plugins.create(plugin.kind, plugins.container(plugin), plugin.kind)
    assert again == plugin
    assert type(again) is type(plugin)


@pytest.mark.parametrize("terrain", at_bounds("terrain"))
def test_a_terrain_draws_the_same_ground_from_the_same_generator(terrain: Terrain) -> None:
    for seed in range(5):
        one, other = (terrain.generate(np.random.default_rng(seed)) for _ in range(2))
        assert isinstance(one, Profile)
        assert one.points.tobytes() == other.points.tobytes()
        assert np.isfinite(one.points).all()


@pytest.mark.parametrize("terrain", at_bounds("terrain"))
def test_the_robot_can_start_on_a_terrain(terrain: Terrain) -> None:
    env = FlipperEnv(config=EnvConfig(terrain=terrain))
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.contains(env.step(4)[0])


@pytest.mark.parametrize("reward", at_bounds("reward"))
def test_a_reward_is_a_finite_number_within_its_bounds(
    reward: RewardTerm, episodes: tuple[list[Perception], list[Transition]]
) -> None:
    _, transitions = episodes
    assert {t.outcome for t in transitions} > {None, Outcome.REACHED}
    values = [reward(t) for t in transitions]
    assert all(isinstance(value, float) for value in values)
    assert np.isfinite(values).all()
    assert reward.bounds[0] <= min(values) <= max(values) <= reward.bounds[1]
    assert values == [reward(t) for t in transitions]  # a pure function of the transition


@pytest.mark.parametrize("controller", at_bounds("controller"))
def test_a_controller_answers_with_an_action(
    controller: Controller, episodes: tuple[list[Perception], list[Transition]]
) -> None:
    perceptions, _ = episodes
    actions = [controller.act(p) for p in perceptions]
    assert all(isinstance(action, int) for action in actions)
    assert set(actions) <= set(range(len(ACTIONS)))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("network", at_bounds("network"))
def test_a_network_gives_finite_values_and_gradients_everywhere(
    network: Network, layout: ObservationLayout
) -> None:
    torch.manual_seed(0)
    module = network.build(layout, len(ACTIONS))
    q = module(torch.randn(7, network.frames * layout.size))
    assert q.shape == (7, len(ACTIONS))
    assert q.dtype == torch.float32
    assert q.isfinite().all()
    q.square().sum().backward()
    for name, parameter in module.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.any(), name


@pytest.mark.parametrize("name", plugins.names("network"))
def test_a_network_uses_every_number_of_the_observation(name: str) -> None:
    torch.manual_seed(0)
    layout = ObservationLayout()
    network = plugins.create("network", name, "network")
    assert isinstance(network, Network)
    observation = torch.randn(4, network.frames * layout.size, requires_grad=True)
    network.build(layout, len(ACTIONS))(observation).square().sum().backward()
    assert observation.grad is not None
    assert (observation.grad != 0).any(dim=0).all()


# Between 1 m before the first edge and 1 m behind the last (paper Tab. I)
@pytest.mark.parametrize(("name", "length"), [("paper_step", 5.0), ("paper_stair", 6.5)])
def test_the_paper_s_scenes_have_the_paper_s_length(name: str, length: float) -> None:
    scene = plugins.create("terrain", name, "terrain")
    assert isinstance(scene, Terrain)
    one, other = (scene.generate(np.random.default_rng(seed)) for seed in (0, 1))
    assert one.end - one.start + 2.0 == pytest.approx(length)
    assert np.array_equal(one.points, other.points)  # nothing is drawn
    assert one.points[-1, 1] == pytest.approx(0.0)  # back on the level
