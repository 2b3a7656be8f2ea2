"""The one loop that plays an episode."""

import itertools
import warnings

import numpy as np
import pytest

from flipperctl.api import Controller, Perception, Policy, Simulator, action_index, controller
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.function import FunctionPolicy
from flipperctl.rollout.episode import Decision, RealTime, decisions, play

HOLD = action_index(0, 0)


def okada() -> Policy:
    return resolver.create("controller", "okada", "controller").build()


def test_a_decision_holds_what_was_decided_on_and_what_came_of_it() -> None:
    env = FlipperEnv("step")
    seen = list(decisions(env, okada(), 3))
    for one, following in itertools.pairwise(seen):
        assert one.next_perception is following.perception
        assert one.transition.after is following.transition.before
        assert one.ending is None
        assert one.reward == pytest.approx(sum(one.rewards.values()))
    assert seen[-1].ending == play(env, okada(), 3)


def test_poses_are_100_hz_and_end_where_the_state_is() -> None:
    (first, *_) = decisions(FlipperEnv("step"), FunctionPolicy(lambda p: action_index(1, 1)), 3)
    assert first.poses.shape == (61, 5)  # 0.6 s, the pose before it included
    after = first.transition.after
    assert first.poses[-1].tolist() == [*after.position, after.pitch, after.front, after.rear]
    # 25 °/s for 0.6 s; the servos hold their 15° within a hundredth
    assert first.poses[-1, 3:] == pytest.approx(np.deg2rad([15, 15]), abs=0.01)
    assert (np.diff(first.poses[:, 3]) > 0).mean() > 0.9


def test_who_stops_iterating_cancels_the_episode() -> None:
    env = FlipperEnv("step")
    for decision in decisions(env, okada(), 3):
        if decision.transition.after.time > 2.0:
            break
    assert 2.0 < env.state.time < 3.0
    assert play(env, okada(), 3)["outcome"] == "reached"  # and the next one is whole


def test_the_pace_is_asked_before_each_decision() -> None:
    asked: list[float] = []
    told = [
        d.transition.before.time
        for d in decisions(FlipperEnv("flat"), okada(), 0, pace=asked.append)
    ]
    assert asked == told


def test_real_time_waits_for_the_rest_of_each_decision() -> None:
    now, slept = 100.0, []
    pace = RealTime(speed=2.0, clock=lambda: now, sleep=slept.append)
    pace(0.0)
    now = 100.1
    pace(0.6)  # due at 100.3
    now = 100.7
    pace(1.2)  # due at 100.6: late
    assert slept == pytest.approx([0.2])


def test_play_shows_every_decision() -> None:
    seen: list[Decision] = []
    row = play(FlipperEnv("flat"), okada(), 0, watch=seen.append)
    assert len(seen) == row["decisions"]


@pytest.mark.usefixtures("registry")
def test_a_controller_of_version_0_1_still_hears_of_each_episode() -> None:
    begun = []
    with pytest.warns(DeprecationWarning, match=r"begin is deprecated.*build"):

        @controller("old_fashioned")
        class OldFashioned(Controller):
            """Written for version 0.1."""

            def begin(self, simulator: Simulator) -> None:
                begun.append(simulator.finish)

            def act(self, p: Perception) -> int:
                return HOLD

    policy = OldFashioned().build()
    play(FlipperEnv("flat"), policy, 0)
    play(FlipperEnv("flat"), policy, 1)
    assert len(begun) == 2
    assert OldFashioned.searches_first


def test_a_controller_that_can_never_decide_is_refused() -> None:
    with warnings.catch_warnings(), pytest.raises(TypeError, match=r"Idle.*act\(p\) or build\(\)"):

        class Idle(Controller):
            """Neither acts nor builds a policy."""
