"""What the environment is asked for: overrides, and requests or plugins that are wrong."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from flipperctl.api import (
    Profile,
    Terrain,
    action_index,
    terrain,
)
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, NonFiniteError, TerrainError

HOLD = action_index(0, 0)
EXACT = {"start_noise": 0.0}


def step_of(height: float) -> dict[str, Any]:
    return {"name": "step", "low": height, "high": height}


def test_dotted_and_nested_overrides_mean_the_same() -> None:
    dotted = FlipperEnv("stair", **{"episode.slack": 2.0, "rewards.pitch.lambda_2": 2.5})
    nested = FlipperEnv("stair", episode={"slack": 2.0}, rewards={"pitch": {"lambda_2": 2.5}})
    assert dotted.config == nested.config
    assert dotted.config.episode.slack == 2.0
    assert dotted.config.episode.run_up == 1.0  # its neighbours keep their defaults
    assert dotted.config.rewards["pitch"].lambda_2 == 2.5
    assert set(dotted.config.rewards) == {"flipper", "pitch", "end"}


def test_a_dropped_reward_term_is_gone_and_an_added_one_counts() -> None:
    env = FlipperEnv(
        "stair", **{"rewards.pitch": None, "rewards.smooth": {"name": "pitch", "weight": 0.5}}
    )
    env.reset(seed=0)
    info = env.step(HOLD)[4]
    assert set(info["rewards"]) == {"flipper", "end", "smooth"}


@pytest.mark.parametrize(
    ("overrides", "path", "help_"),
    [
        ({"episode.slak": 2.0}, "episode.slak", "'slack'"),
        ({"episode": {"slak": 2.0}}, "episode.slak", "'slack'"),
        ({"episod.slack": 2.0}, "episod", "'episode'"),
        ({"terrain.ris": 0.1}, "terrain.ris", "'rise'"),
        ({"terrain.rise": 5.0}, "terrain.rise", "≤ 0.5"),
        ({"robot.track_speed": "fast"}, "robot.track_speed", "'fast'"),
        ({"robot.track_speed": math.nan}, "robot.track_speed", "finite"),
        ({"sim.substep": 0.003}, "sim", "0.01 s"),
        ({"rewards.pitch.lambda": 1.0}, "rewards.pitch.lambda", "'lambda_2'"),
        ({"rewards.energy": "ptch"}, "rewards.energy", "'pitch'"),
        ({"rewards.pich.lambda_2": 1.0}, "rewards.pich", "'pitch'"),
        ({"rewards": None}, "rewards", "mapping"),
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
    [4.5, "3", None, True, np.float64(4.0), np.array([4]), -1, 9, [4], math.nan, np.bool_(True)],
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
    env.reset(seed=0)
    while not any(env.step(HOLD)[2:4]):
        pass
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(HOLD)


def test_an_unknown_render_mode_is_refused() -> None:
    with pytest.raises(ConfigError, match="no mode 'nonsense'; None or 'rgb_array' is allowed"):
        FlipperEnv("flat", render_mode="nonsense")
    with pytest.raises(ConfigError, match="did you mean 'rgb_array'"):
        FlipperEnv("flat", render_mode="rgbarray")


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
        (lambda: Profile([]), "empty"),
        (lambda: Profile([(0.0, 0.0), (1.0, math.nan)]), "point 1 is not finite"),
        (lambda: [(0.0, 0.0), (1.0, 0.0)], "must return a Profile; it returned a list"),
        (lambda: None, "must return a Profile; it returned a NoneType"),
        (lambda: Profile([(0, 0)], drawn=["steps"]), "are a list, ['steps']; a mapping"),
        (lambda: Profile([(0, 0)], drawn={"a b": 1}), "have the name 'a b'; a word"),
        (lambda: Profile([(0, 0)], drawn={"n": math.inf}), "have n = inf; a finite number"),
    ],
    ids=["x decreases", "empty", "not finite", "list", "None", "drawn", "name", "infinite"],
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


def test_a_state_that_is_not_finite_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    lost = dataclasses.replace(env.state, pitch=math.nan)
    monkeypatch.setattr(env.drive.world.unguarded, "state", lambda: lost)
    with pytest.raises(NonFiniteError, match=r"sim 'planar': state returned nan as pitch"):
        env.step(HOLD)


# Measures


def test_a_robot_too_slow_for_a_finite_time_is_refused() -> None:
    env = FlipperEnv("flat", **{"robot.track_speed": 5e-324, "episode.stuck_progress": 0})
    with pytest.raises(
        ConfigError, match=r"robot\.track_speed: at 4\.94066e-324 m/s the distance of \d"
    ):
        env.reset(seed=0)
