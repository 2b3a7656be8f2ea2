"""``rollouts``: it improves a policy, with pairs and with four flippers, and it teaches."""

import numpy as np
import pytest

from flipperctl.api import Perception
from flipperctl.config import Teacher
from flipperctl.core.targets import ActionKind
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.lookahead import Rollouts
from flipperctl.lookahead.rollouts import FAILED, RolloutPolicy
from flipperctl.policies.controllers import DaggerPolicy, plugin_policy
from flipperctl.policies.greedy import GreedyPolicy
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import decisions, play

GENERALIST = load_policy("generalist")


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


def test_actions_that_are_not_tried_cost_most_and_trials_change_nothing() -> None:
    env = FlipperEnv("step", sim={"name": "mujoco", "one_sided": 1}, robot={"flippers": "four"})
    policy = RolloutPolicy(Rollouts(breadth=3, horizon=2), Holds())
    for at, decision in enumerate(decisions(env, policy, 5)):
        tried = policy.costs(decision.next_perception)
        assert tried.shape == (81,)
        assert (tried < tried.min() + FAILED).sum() <= 3
        assert np.isfinite(tried).all()
        simulated = policy._simulator.state
        assert simulated.position == pytest.approx(decision.transition.after.position, abs=0.01)
        if at == 2:
            break


def test_it_teaches_a_student_whose_episode_it_follows() -> None:
    env = FlipperEnv("step")
    settings = Teacher(label_share=0.5, student_share=1.0)
    student = GENERALIST.build(env.config)
    rollouts = Rollouts(horizon=2, breadth=2)
    rollouts._trained = student  # type: ignore[assignment]
    teacher = plugin_policy(rollouts)
    rng = np.random.default_rng(1)
    policy = DaggerPolicy(student, teacher, settings, lambda: True, rng)
    labels = []
    for decision in decisions(env, policy, 7):
        labels.append(policy.label)
        simulated = teacher._policy._simulator.state
        assert simulated.position == pytest.approx(decision.transition.before.position, abs=0.02)
    sums = np.sum(labels, axis=1)
    assert {0.0, 1.0} == set(np.round(sums, 5))


def test_a_policy_without_values_is_refused() -> None:
    with pytest.raises(ConfigError, match="no policy of Q-values"):
        Rollouts().build()
