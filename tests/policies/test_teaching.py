"""Labels of teachers: costs and actions as distributions, values of states, and wrong answers."""

import math
from itertools import islice
from typing import Any, ClassVar

import numpy as np
import pytest

from flipperctl.api import (
    ACTIONS,
    Controller,
    FloatArray,
    ObservationLayout,
    Perception,
    Policy,
    RewardTerm,
    Simulator,
    StateGroups,
)
from flipperctl.config import EnvConfig, Teacher, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, PluginFailedError
from flipperctl.lookahead.mpc import NO_PLAN
from flipperctl.policies import controllers as labels
from flipperctl.policies.controllers import (
    DaggerPolicy,
    DemonstratingPolicy,
    PluginPolicy,
    plugin_policy,
)
from flipperctl.policies.source import controller_policy
from flipperctl.rollout.episode import decisions, steps


def policy(name: str, **settings: object) -> PluginPolicy:
    return plugin_policy(resolver.create("controller", {"name": name, **settings}, "controller"))


def test_an_action_that_costs_a_temperature_more_is_e_times_less_probable() -> None:
    costs = np.array([1.3, 1.0, 1.6, *[NO_PLAN] * 6])
    label = labels.from_costs(costs, temperature=0.3)
    whole = 1 + np.exp(-1) + np.exp(-2)
    assert label[:3] == pytest.approx([np.exp(-1) / whole, 1 / whole, np.exp(-2) / whole])
    assert label.dtype == np.float32
    assert not label[3:].any()
    assert labels.from_action(7).tolist() == [0, 0, 0, 0, 0, 0, 0, 1, 0]


def test_only_some_controllers_offer_costs() -> None:
    mpc, okada = policy("mpc", value=""), policy("okada")
    assert (mpc.offers_costs, mpc.follows, mpc.values_states) == (True, True, False)
    assert (okada.offers_costs, okada.follows, okada.values_states) == (False, False, False)
    valuing = resolver.create("controller", "value_iteration", "controller")
    assert controller_policy(valuing, EnvConfig(terrain="flat")).values_states


def test_a_collector_keeps_the_labels_of_any_policy_that_has_them() -> None:
    for acting, labelled in (
        (policy("okada"), False),
        (DemonstratingPolicy(policy("okada")), True),
    ):
        step = next(steps(FlipperEnv("flat"), acting, 1))
        expected = labels.from_action(step.action).tolist() if labelled else None
        assert (step.label if step.label is None else step.label.tolist()) == expected


def test_the_cheapest_action_of_mpc_is_the_one_that_it_takes() -> None:
    env = FlipperEnv("pallet")
    env.reset(seed=3)
    asked, acting = (policy("mpc", value="", beam=2, horizon=3) for _ in range(2))
    for one in (asked, acting):
        one.reset(env.simulator(lambda fraction: None))
    for _ in range(8):
        p = env.perception
        action = acting.act(p)
        costs = asked.costs(p)
        assert costs[action] == costs.min()
        asked.took(action)
        if any(env.step(action)[2:4]):
            break
    # Its flippers turn only as far as their stops, so that some actions have no plan.
    assert costs.shape == (len(ACTIONS),)


def test_mpc_plans_on_from_an_action_that_was_not_its_own() -> None:
    env = FlipperEnv("flat")
    env.reset(seed=1)
    asked = policy("mpc", value="", beam=2, horizon=2)
    asked.reset(env.simulator(lambda fraction: None))
    up = len(ACTIONS) - 1
    for _ in range(40):
        costs = asked.costs(env.perception)
        asked.took(up)
        if any(env.step(up)[2:4]) or costs[up] == NO_PLAN:
            break
    assert costs[up] == NO_PLAN  # the flippers stand at their stops, as the policy knows
    assert costs.min() < NO_PLAN


SIZE = ObservationLayout().size
SEEN, VALUES = np.zeros((2, 3, SIZE), np.float32), np.zeros((2, 3, len(ACTIONS)), np.float32)


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
        """Return costs, one of which is no number."""
        return np.array([0.0] * 8 + [math.nan])

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


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (None, "returned None; allowed: StateGroups of finite numbers"),
        (StateGroups(SEEN, VALUES[:1]), "StateGroups of finite numbers"),
        (StateGroups(SEEN, np.full_like(VALUES, np.inf)), "StateGroups of finite numbers"),
        (StateGroups(np.full_like(SEEN, np.nan), VALUES), "StateGroups of finite numbers"),
        (StateGroups(SEEN[:0], VALUES[:0]), "StateGroups of finite numbers"),
        (StateGroups(SEEN.tolist(), VALUES), "AttributeError"),
    ],
)
def test_a_plugin_whose_groups_are_nonsense_is_named(answer: Any, text: str) -> None:
    policy = plugin_policy(Rater(answer=answer))
    assert policy.values_states
    with pytest.raises(PluginFailedError, match=rf"(?s)'rater'.*groups.*{text}.*test_teaching\.py"):
        policy.state_groups(np.random.default_rng(0))


def test_a_cost_that_is_not_finite_names_the_controller() -> None:
    env = FlipperEnv("flat")
    env.reset(seed=1)
    with pytest.raises(PluginFailedError, match=r"costs returned .*9 finite costs are allowed"):
        plugin_policy(Rater()).costs(env.perception)


def test_value_iteration_follows_the_episode_whoever_asks_for_its_costs() -> None:
    config = EnvConfig(
        terrain={"name": "step", "platform": 0.3},
        episode={"run_up": 0.8, "run_out": 0.2},
        rewards={"pitch": "pitch", "end": "end"},
    )
    found = resolver.create("controller", "value_iteration", "controller")
    assert isinstance(found, Controller)
    own = controller_policy(found, config)
    teacher = {"controller": "value_iteration", "student_share": 0, "random": 0}
    rng = np.random.default_rng(0)
    dagger = DaggerPolicy(Rating(None), own, Teacher(**teacher, privileged=True), bool, rng)
    played = [
        [d.action for d in islice(decisions(FlipperEnv(config=config), policy, seed=5), 30)]
        for policy in (own, DemonstratingPolicy(own), dagger)
    ]
    assert len(set(played[0])) > 1
    assert played[0] == played[1] == played[2]


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
