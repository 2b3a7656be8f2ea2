"""The one episode loop."""

import itertools

import numpy as np
import pytest

from flipperctl.api import Controller, Policy, action_index
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.controllers import FunctionPolicy
from flipperctl.rollout.episode import decisions, play


def okada() -> Policy:
    return resolver.create("controller", "okada", "controller").build()


def test_a_decision_holds_the_policy_s_input_and_the_results() -> None:
    env = FlipperEnv("step")
    episode = list(decisions(env, okada(), 3))
    for one, following in itertools.pairwise(episode):
        assert one.next_perception is following.perception
        assert one.transition.after is following.transition.before
        assert one.ending is None
        assert one.reward == pytest.approx(sum(one.rewards.values()))
    assert episode[-1].ending == play(env, okada(), 3)


def test_poses_are_100_hz_and_end_where_the_state_is() -> None:
    (first, *_) = decisions(FlipperEnv("step"), FunctionPolicy(lambda p: action_index(1, 1)), 3)
    assert first.poses.shape == (61, 5)  # 0.6 s, the pose before it included
    after = first.transition.after
    assert first.poses[-1].tolist() == [*after.position, after.pitch, after.front, after.rear]
    # 25 °/s for 0.6 s; the servos hold their 15° within a hundredth
    assert first.poses[-1, 3:] == pytest.approx(np.deg2rad([15, 15]), abs=0.01)
    assert (np.diff(first.poses[:, 3]) > 0).mean() > 0.9


def test_to_stop_iterating_cancels_the_episode() -> None:
    env = FlipperEnv("step")
    for decision in decisions(env, okada(), 3):
        if decision.transition.after.time > 2.0:
            break
    assert 2.0 < env.state.time < 3.0
    assert play(env, okada(), 3)["outcome"] == "reached"  # the next episode is complete


def test_a_controller_without_act_and_build_or_with_begin_is_refused() -> None:
    with pytest.raises(TypeError, match=r"Idle.*act\(p\) or build\(\)"):
        type("Idle", (Controller,), {})
    with pytest.raises(TypeError, match=r"Old: begin is never called; write build\(\)"):
        type("Old", (Controller,), {"begin": lambda *_: None, "act": lambda *_: 4})
