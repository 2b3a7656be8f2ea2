"""The environment: Gymnasium, actions, signs, outcomes, overrides, errors and measures."""

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from flipperctl.api import (
    ACTIONS,
    MAX_HISTORY,
    Outcome,
    action_index,
)
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv

HOLD = action_index(0, 0)
FRONT, REAR = -3, -2  # before the pitch, at the end of an observation
EXACT = {"start_noise": 0.0}


def step_of(height: float) -> dict[str, Any]:
    return {"name": "step", "low": height, "high": height}


def rollout(env: FlipperEnv, controller: str, seed: int = 0) -> list[tuple[Any, ...]]:
    """Play one episode and return the results of each ``step``."""
    chosen = resolver.create("controller", controller, "controller").build()
    env.reset(seed=seed)
    steps = []
    while True:
        steps.append(env.step(chosen.act(env.perception)))
        if steps[-1][2] or steps[-1][3]:
            return steps


def test_a_perception_remembers_its_episode_and_no_other() -> None:
    env = FlipperEnv("flat")
    for seed in (0, 1):
        observations = [env.reset(seed=seed)[0]]
        assert len(env.perception.recent) == 1
        observations += [env.step(HOLD)[0] for _ in range(MAX_HISTORY + 1 if seed else 5)]
        recent = env.perception.recent
        assert np.array_equal(recent, observations[-MAX_HISTORY:])
        assert recent[-1] is env.perception.observation


# Gymnasium


def test_make_finds_the_environment_and_takes_overrides() -> None:
    env = gymnasium.make("flipperctl/Flipper-v0", terrain="stair", episode={"slack": 2.0})
    assert isinstance(env.unwrapped, FlipperEnv)
    assert env.unwrapped.config.terrain.plugin_name == "stair"
    assert env.unwrapped.config.episode.slack == 2.0


@pytest.mark.filterwarnings("error")
def test_gymnasium_s_own_checker_has_nothing_to_say() -> None:
    env = gymnasium.make("flipperctl/Flipper-v0", terrain="stair", perception={"noise": 0.01})
    check_env(env.unwrapped)
    env.close()


# Actions and signs


@pytest.mark.parametrize(("front", "rear"), ACTIONS)
def test_each_action_turns_its_pairs_by_one_angle_step(front: int, rear: int) -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    observation, *_ = env.step(3 * (front + 1) + (rear + 1))
    turned = np.array([front, rear]) * math.pi / 12
    assert observation[[FRONT, REAR]] == pytest.approx(turned, abs=0.01)


# Episodes


def test_equal_seeds_give_the_same_episode_bit_for_bit() -> None:
    noisy = {"noise": 0.02, "dropout": 0.1, "angle_noise": 0.01}
    first, second = (
        rollout(FlipperEnv("stair", perception=noisy), "random", seed=5) for _ in range(2)
    )
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        assert one[0].tobytes() == other[0].tobytes()
        assert one[1:] == other[1:]


def test_sensing_noise_changes_neither_terrain_nor_start() -> None:
    clean, noisy = FlipperEnv("step"), FlipperEnv("step", perception={"noise": 0.05})
    for seed in (3, None, None):  # nor those of the episodes that follow
        (seen, _), (seen_noisy, _) = clean.reset(seed=seed), noisy.reset(seed=seed)
        assert np.array_equal(clean.profile.points, noisy.profile.points)
        assert np.array_equal(clean.state.position, noisy.state.position)
        assert not np.array_equal(seen, seen_noisy)


def test_the_start_lies_the_run_up_before_the_first_edge() -> None:
    starts = []
    for seed in range(20):
        env = FlipperEnv("step", episode={"run_up": 1.5, "start_noise": 0.1})
        env.reset(seed=seed)
        starts.append(env.state.position[0])
    assert -1.6 <= min(starts) < -1.5 < max(starts) <= -1.4


@pytest.mark.parametrize(
    ("name", "controller", "episode", "outcome"),
    [
        ("flat", "level", {}, Outcome.REACHED),
        (step_of(-1.0), "level", {}, Outcome.OVERTURNED),  # it falls on its nose
        (step_of(0.4), "level", {}, Outcome.STUCK),  # too high without the flippers' help
        ("paper_step", "okada", {"slack": 1.05}, Outcome.TIMEOUT),  # 26 s where 30 are needed
    ],
)
def test_each_outcome(
    name: Any, controller: str, episode: dict[str, float], outcome: Outcome
) -> None:
    env = FlipperEnv(name, episode=episode, **{"rewards.end.settlement": 7.0})
    *before, last = rollout(env, controller)
    _, _, terminated, truncated, info = last
    assert info["outcome"] == outcome
    assert truncated == (outcome is Outcome.TIMEOUT)
    assert terminated == (outcome is not Outcome.TIMEOUT)
    assert info["rewards"]["end"] == (7.0 if outcome is Outcome.REACHED else -7.0)
    assert not any("outcome" in step[4] or step[4]["rewards"]["end"] for step in before)


def test_the_finish_counts_only_with_the_chassis_close_to_the_ground() -> None:
    env = FlipperEnv("flat", episode={**EXACT, "slack": 1.5})
    env.reset(seed=0)
    over = False
    while not over:  # on raised stilts, 0.29 m above the ground
        *_, terminated, truncated, info = env.step(action_index(-1, -1))
        over = terminated or truncated
    assert info["outcome"] == Outcome.TIMEOUT
    assert env.state.position[0] > env.profile.end + 1.0


# Overrides


def test_the_metrics_are_what_the_episode_shows() -> None:
    env = FlipperEnv("paper_step", episode=EXACT)
    rule = resolver.create("controller", "okada", "controller").build()
    env.reset(seed=0)
    states, rewards, info = [env.state], [], {}
    while "metrics" not in info:
        _, value, *_, info = env.step(rule.act(env.perception))
        states.append(env.state)
        rewards.append(value)
    metrics = info["metrics"]
    angles = np.array([(s.pitch, s.front, s.rear) for s in states])
    swing, front, rear = np.abs(np.diff(angles, axis=0)).sum(axis=0)
    assert metrics["pitch_variation"] == pytest.approx(swing)  # paper Eq. 8
    assert metrics["flipper_travel"] == pytest.approx(front + rear)
    assert metrics["pitch_variation_100hz"] >= metrics["pitch_variation"] > 1.0
    assert metrics["max_pitch"] >= np.abs(angles[:, 0]).max()
    assert metrics["return"] == pytest.approx(sum(rewards))
    assert metrics["decisions"] == len(rewards)
    assert metrics["t_cost"] == env.state.time


def test_t_cost_is_the_time_to_the_finish_and_not_to_the_end_of_the_decision() -> None:
    # From 1 m before to 1 m behind 2 m of level ground at 0.2 m/s: 20 s, in the 34th decision.
    metrics = rollout(FlipperEnv("flat", episode=EXACT), "level")[-1][4]["metrics"]
    assert metrics["t_cost"] == pytest.approx(20.0, rel=0.005)
    assert metrics["decisions"] == 34
    assert metrics["pitch_variation"] == pytest.approx(0.0, abs=0.01)
