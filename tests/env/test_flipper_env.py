"""The environment: Gymnasium, actions, signs, outcomes, overrides, measures, wrong requests."""

import math
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from flipperctl.api import (
    ACTIONS,
    MAX_HISTORY,
    Outcome,
    Profile,
    Terrain,
    action_index,
    terrain,
)
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, TerrainError

HOLD = action_index(0, 0)
FRONT, REAR = -3, -2  # before the pitch, at the end of an observation
EXACT = {"start_noise": 0.0}


def step_of(height: float) -> dict[str, Any]:
    return {"name": "step", "height": height}


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
    assert metrics["pitch_variation_decisions"] == pytest.approx(swing)  # paper Eq. 8
    assert metrics["flipper_travel"] == pytest.approx(front + rear)
    assert metrics["pitch_variation_100hz"] >= metrics["pitch_variation_decisions"] > 1.0
    assert metrics["max_pitch"] >= np.abs(angles[:, 0]).max()
    assert metrics["return"] == pytest.approx(sum(rewards))
    assert metrics["decisions"] == len(rewards)
    assert metrics["t_cost"] == env.state.time


def test_t_cost_is_the_time_to_the_finish_and_not_to_the_end_of_the_decision() -> None:
    # From 1 m before to 1 m behind 2 m of level ground at 0.2 m/s: 20 s, in the 34th decision.
    metrics = rollout(FlipperEnv("flat", episode=EXACT), "level")[-1][4]["metrics"]
    assert metrics["t_cost"] == pytest.approx(20.0, rel=0.005)
    assert metrics["decisions"] == 34
    assert metrics["pitch_variation_decisions"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("overrides", "path", "help_"),
    [
        ({"episode.slak": 2.0}, "episode.slak", "'slack'"),
        ({"episod.slack": 2.0}, "episod", "'episode'"),
        ({"terrain.rise": 5.0}, "terrain.rise", "≤ 0.5"),
        ({"robot.track_speed": math.nan}, "robot.track_speed", "finite"),
        ({"rewards.pitch.lambda": 1.0}, "rewards.pitch.lambda", "'lambda_2'"),
        ({"rewards": "pitch"}, "rewards", "mapping"),
        ({"robot.flipper_length": 0.3, "robot.track_radius": 0.15}, "robot", "length (0.3 m)"),
        ({"robot.track_radius": 0.3}, "robot", "must exceed twice track_radius (0.3 m)"),
        ({"robot.angle_step": 0.004}, "robot.angle_step", "at least 0.01 s"),
        ({"robot.control_period": 0.004}, "robot.control_period", "at least 0.01 s"),
        ({"robot.actuator_delay": 0.3, "robot.angle_step": 0.1}, "robot.actuator_delay", "0.229"),
        ({"perception.delay": 0.3, "robot.angle_step": 0.1}, "perception.delay", "0.229"),
        ({"episode.start_angle": -1.2}, "episode.start_angle", "robot.angle_limit, 1.0472 rad"),
        # 20 decisions of 0.6 s at 0.2 m/s are 2.4 m.
        ({"episode.stuck_progress": 2.5}, "episode.stuck_progress", "at most 2.4 m"),
        # A progress over 3 s, which is 5 decisions, is at most 0.6 m.
        ({"episode": {"stuck_progress": 2.0, "stuck_time": 3.0}}, "episode", "at most 0.6 m"),
        ({"episode": {"stuck_window": 30, "stuck_time": 3.0}}, "episode", "no effect with stuck_"),
        ({"robot.track_radius.x": 1.0}, "robot.track_radius", "track_radius"),
    ],
    ids=str,
)
def test_a_wrong_override_is_named_with_what_is_allowed(
    overrides: dict[str, Any], path: str, help_: str
) -> None:
    with pytest.raises(ConfigError) as error:
        FlipperEnv("stair", **overrides)
    assert str(error.value).startswith(path)
    assert help_ in str(error.value)
    assert "\n" not in str(error.value)


# Wrong use


@pytest.mark.parametrize(
    "action",
    [
        *(4.5, "3", None, True, np.float64(4.0), np.array([4]), -1, 9, [4], math.nan),
        *((1.1, 0.0), (math.nan, 0.0), (True, False)),  # no rates either
    ],
    ids=repr,
)
def test_what_is_no_action_is_refused(action: Any) -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"there is no action .*; an integer from 0 to 8") as error:
        env.step(action)
    assert repr(action) in str(error.value)
    env.step(HOLD)


@pytest.mark.parametrize("action", [4, np.int64(4), np.uint8(4), np.array(4)], ids=repr)
def test_every_integer_is_an_action(action: Any) -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    env.step(action)
    assert env.transition.action == (0, 0)


def test_a_seed_of_the_environment_is_that_of_the_first_reset() -> None:
    first, again = (
        gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain="stair", seed=7)
        for _ in range(2)
    )
    copied = pickle.loads(pickle.dumps(again.unwrapped))
    expected, _ = FlipperEnv("stair").reset(seed=7)
    for env in (first, copied):
        assert (env.reset()[0] == expected).all()
    assert (first.reset()[0] == copied.reset()[0]).all()
    assert (again.reset(seed=8)[0] == FlipperEnv("stair").reset(seed=8)[0]).all()


def test_a_step_outside_an_episode_asks_for_a_reset() -> None:
    env = FlipperEnv("flat", episode={"run_out": 0.0, "run_up": 0.2})
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(HOLD)
    drawn = FlipperEnv("flat", render_mode="rgb_array")
    for ask in (lambda: env.scene, lambda: drawn.render()):
        with pytest.raises(ResetNeeded, match="call reset first"):
            ask()
    for difficulty in (5, -0.1, math.nan, 10**400, "hard"):
        with pytest.raises(ValueError, match="0 to 1 is allowed"):
            env.reset(options={"difficulty": difficulty})
    with pytest.raises(ValueError, match="'dificulty'; 'difficulty' is allowed"):
        env.reset(options={"dificulty": 0.0})
    env.reset(seed=0)
    while not any(env.step(HOLD)[2:4]):
        pass
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(HOLD)


def test_no_rewards_at_all_are_asked_for_by_an_empty_mapping() -> None:
    env = FlipperEnv("flat", rewards={})
    env.reset(seed=0)
    _, reward, *_, info = env.step(HOLD)
    assert (reward, info["rewards"]) == (0, {})
    assert list(FlipperEnv("flat", rewards={"pitch": {"weight": 2}}).config.rewards) == [
        *("flipper", "pitch", "end")
    ]


# Broken plugins


@pytest.mark.parametrize(
    ("generate", "text"),
    [
        (lambda: Profile([(0.0, 0.0), (1.0, 0.0), (0.5, 0.2)]), "x decreases from 1 to 0.5 m"),
        (lambda: Profile([(0.0, 0.0), (1.0, math.nan)]), "point 1 is not finite"),
        (lambda: [(0.0, 0.0), (1.0, 0.0)], "must return a Profile; it returned a list"),
        (lambda: Profile([(0, 0)], drawn={"n": math.inf}), "have 'n': inf; words with finite"),
    ],
    ids=["x decreases", "not finite", "list", "drawn"],
)
def test_a_broken_terrain_is_named(generate: Callable[[], Any], text: str, registry: dict) -> None:
    @terrain("broken")
    class Broken(Terrain):
        def generate(self, rng: np.random.Generator) -> Profile:
            return generate()

    with pytest.raises(TerrainError, match="'broken'") as error:
        FlipperEnv("broken").reset(seed=0)
    assert text in str(error.value)


def test_a_terrain_that_starts_in_the_robot_is_named() -> None:
    # The front flippers reach 0.28 + 0.336 + 0.1 = 0.716 m ahead of the chassis centre.
    with pytest.raises(TerrainError, match="'step' overlaps the robot at the start"):
        FlipperEnv(step_of(0.4), episode={**EXACT, "run_up": 0.65}).reset(seed=0)
    FlipperEnv(step_of(0.4), episode={**EXACT, "run_up": 0.72}).reset(seed=0)


# Measures


def test_a_robot_too_slow_for_a_finite_time_is_refused() -> None:
    env = FlipperEnv("flat", **{"robot.track_speed": 5e-324, "episode.stuck_progress": 0})
    with pytest.raises(
        ConfigError, match=r"robot\.track_speed: at 4\.94066e-324 m/s the distance of \d"
    ):
        env.reset(seed=0)
