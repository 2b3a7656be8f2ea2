"""Labels: costs and actions as distributions over actions, and the controllers that offer costs."""

import numpy as np
import pytest

from flipperctl.api import ACTIONS, Controller, CostPolicy, Perception, Simulator
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import PluginFailedError
from flipperctl.lookahead.mpc import NO_PLAN
from flipperctl.policies import teaching as labels
from flipperctl.policies.plugin import PluginPolicy, plugin_policy
from flipperctl.policies.teaching import DemonstratingPolicy
from flipperctl.rollout.steps import steps


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
    assert policy("mpc", value="").offers_costs
    assert not policy("okada").offers_costs


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
    asked, acting = (policy("mpc", value="", beam=4, horizon=4) for _ in range(2))
    for one in (asked, acting):
        one.reset(env.simulator(lambda fraction: None))
    for _ in range(25):
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


class _Wrong:
    def reset(self, simulator: Simulator) -> None:
        """Begin an episode."""

    def act(self, p: Perception) -> int:
        """Return an action."""
        return 0

    def costs(self, p: Perception) -> list[float]:
        """Return costs, one of which is no number."""
        return [0.0] * 8 + [float("nan")]

    def took(self, action: int) -> None:
        """Receive the action."""


class _WrongCosts(Controller):
    def build(self) -> _Wrong:
        """Return the policy."""
        return _Wrong()


def test_a_cost_that_is_not_finite_names_the_controller() -> None:
    assert isinstance(_Wrong(), CostPolicy)
    env = FlipperEnv("flat")
    env.reset(seed=1)
    with pytest.raises(PluginFailedError, match=r"costs returned .*9 finite costs are allowed"):
        plugin_policy(_WrongCosts()).costs(env.perception)
