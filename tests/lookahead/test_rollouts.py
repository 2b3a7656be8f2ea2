"""``rollouts``: it improves a policy, with pairs and with four flippers."""

import pytest

from flipperctl.api import Perception
from flipperctl.core.targets import ActionKind, actions_of
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.lookahead import Rollouts
from flipperctl.lookahead.rollouts import RolloutPolicy
from flipperctl.policies.greedy import GreedyPolicy
from flipperctl.rollout.episode import decisions, play


class Holds:
    """Prefers to hold all flippers, then the first actions."""

    kind: ActionKind = "turns"

    def q_values(self, p: Perception) -> list[float]:
        actions = 3 ** len(p.layout.joints)
        return [float(action == actions // 2) - action / actions for action in range(actions)]


def test_it_is_smoother_than_the_policy_that_it_improves() -> None:
    env = FlipperEnv("step")
    policies = GreedyPolicy([Holds()]), RolloutPolicy(Rollouts(breadth=9), Holds())
    held, tried = (play(env, policy, seed=4) for policy in policies)
    assert held["outcome"] == tried["outcome"] == "reached"
    assert tried["pitch_variation_100hz"] < 0.5 * held["pitch_variation_100hz"]


def test_the_simulator_of_four_flippers_follows_the_episode_and_few_actions_are_tried() -> None:
    env = FlipperEnv("step", sim={"name": "mujoco", "one_sided": 1}, robot={"flippers": "four"})
    policy = RolloutPolicy(Rollouts(breadth=3, horizon=2), Holds())
    hold, *others = (actions_of(4)[action] for action in (40, 0, 1))
    for at, decision in enumerate(decisions(env, policy, 5)):
        assert actions_of(4)[decision.action] in (hold, *others)
        before = decision.transition.before
        assert policy._simulator.state.position == pytest.approx(before.position, abs=0.01)
        if at == 2:
            break


def test_a_policy_without_values_is_refused() -> None:
    with pytest.raises(ConfigError, match="no policy of Q-values"):
        Rollouts().build()
