"""Policies that value states beside their way, and checks of what plugins return."""

from typing import Any, ClassVar

import numpy as np
import pytest

from flipperctl.api import (
    ACTIONS,
    Controller,
    FloatArray,
    Perception,
    Policy,
    RewardTerm,
    Simulator,
    StateGroups,
)
from flipperctl.config import EnvConfig, Teacher, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, PluginFailedError
from flipperctl.policies.plugin import plugin_policy
from flipperctl.policies.source import controller_policy
from flipperctl.policies.teaching import DaggerPolicy, DemonstratingPolicy
from flipperctl.rollout.episode import decisions

SEEN, VALUES = np.zeros((2, 3, 18), np.float32), np.zeros((2, 3, len(ACTIONS)), np.float32)


class Rating:
    """Holds the flippers; values states as its settings say."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""

    def act(self, p: Perception) -> int:
        """Hold the flippers."""
        return 4

    def costs(self, p: Perception) -> FloatArray:
        """Return equal costs."""
        return np.zeros(len(ACTIONS))

    def took(self, action: int) -> None:
        """Forget the action."""

    def groups(self, rng: np.random.Generator) -> StateGroups:
        """Return what the settings say."""
        if isinstance(self._answer, Exception):
            raise self._answer
        return self._answer


class Rater(Controller):
    """Builds a policy that values states."""

    plugin_name: ClassVar[str] = "rater"
    answer: Any = None

    def build(self) -> Policy:
        """Return the policy of the settings."""
        return Rating(self.answer)


def test_groups_that_are_right_are_passed_on() -> None:
    answer = StateGroups(SEEN, VALUES)
    policy = plugin_policy(Rater(answer=answer))
    assert policy.values_states
    assert policy.state_groups(np.random.default_rng(0)) is answer


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (None, "returned None; StateGroups of finite numbers are allowed"),
        ((SEEN, VALUES), "StateGroups of finite numbers are allowed"),
        (StateGroups(SEEN, VALUES[:1]), "StateGroups of finite numbers"),
        (StateGroups(SEEN, VALUES[:, :, :4]), "StateGroups of finite numbers"),
        (StateGroups(SEEN, np.full_like(VALUES, np.inf)), "StateGroups of finite numbers"),
        (StateGroups(np.full_like(SEEN, np.nan), VALUES), "StateGroups of finite numbers"),
        (StateGroups(SEEN[0], VALUES[0]), "StateGroups of finite numbers"),
        (StateGroups(SEEN[..., None], VALUES), "StateGroups of finite numbers"),
        (StateGroups(SEEN[:0], VALUES[:0]), "StateGroups of finite numbers"),
        (StateGroups(SEEN.tolist(), VALUES), "AttributeError"),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_a_plugin_whose_groups_are_nonsense_is_named(answer: Any, text: str) -> None:
    policy = plugin_policy(Rater(answer=answer))
    assert policy.values_states
    with pytest.raises(PluginFailedError, match=rf"(?s)'rater'.*groups.*{text}.*test_valuing\.py"):
        policy.state_groups(np.random.default_rng(0))


@pytest.mark.parametrize("name", ["mpc", "okada", "level"])
def test_most_controllers_value_no_states(name: str) -> None:
    found = resolver.create("controller", name, "controller")
    assert isinstance(found, Controller)
    policy = controller_policy(found, EnvConfig(terrain="flat"))
    assert not policy.values_states


def test_value_iteration_gets_the_rewards_of_the_environment() -> None:
    found = resolver.create("controller", "value_iteration", "controller")
    assert isinstance(found, Controller)
    assert controller_policy(found, EnvConfig(terrain="flat")).values_states


def test_value_iteration_follows_the_episode_whoever_asks_for_its_costs() -> None:
    config = EnvConfig(terrain="step", rewards={"pitch": "pitch", "end": "end"})
    found = resolver.create("controller", "value_iteration", "controller")
    assert isinstance(found, Controller)
    own = controller_policy(found, config)
    teacher = {"controller": "value_iteration", "student_share": 0, "random": 0}
    rng = np.random.default_rng(0)
    policies = (
        own,
        DemonstratingPolicy(own),
        *(
            DaggerPolicy(Rating(None), own, Teacher(**teacher, privileged=known), bool, rng)
            for known in (False, True)
        ),
    )
    played = [
        [d.action for d in decisions(FlipperEnv(config=config), policy, seed=5)]
        for policy in policies
    ]
    assert len(set(played[0])) > 1
    assert played[0] == played[1] == played[2] == played[3]


class Odd(RewardTerm):
    """A term that needs what predictions lack."""

    plugin_name: ClassVar[str] = "odd"
    not_predicted: ClassVar[str] = "the motors' currents"

    def __call__(self, t: object) -> float:
        return 0.0


def test_value_iteration_refuses_terms_that_predictions_lack() -> None:
    found = resolver.create("controller", "value_iteration", "controller")
    config = EnvConfig(terrain="flat").model_copy(update={"rewards": {"strange": Odd()}})
    with pytest.raises(ConfigError, match=r"^rewards\.strange: a search cannot predict"):
        controller_policy(found, config)


def test_an_episode_with_a_teacher_has_its_groups() -> None:
    answer = StateGroups(SEEN, VALUES)
    settings = Teacher(controller="value_iteration", loss="values")
    rng = np.random.default_rng(0)
    env = FlipperEnv("flat")
    env.reset(seed=0)
    for controller, expected in ((Rater(answer=answer), answer), ("okada", None)):
        made = resolver.create("controller", controller, "controller")
        policy = DaggerPolicy(Rating(None), plugin_policy(made), settings, lambda: True, rng)
        assert policy.groups is None
        policy.reset(env.simulator())
        assert policy.groups is expected
