"""Copies and pickles of an environment go on as the original does."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError

ACTIONS = [4, 8, (0.25, -1.0), 5, 3, 7, (0.0, 0.3), 1]


def went_on(env: Any, actions: list[Any]) -> list[bytes]:
    """Return all that an episode and the next one show."""
    steps = [env.step(action) for action in actions]
    found = [step[0].tobytes() + repr(step[1:]).encode() for step in steps]
    observation, _ = env.reset()
    return [*found, observation.tobytes(), env.step(4)[0].tobytes()]


@pytest.mark.parametrize(
    ("made", "begun"),
    [(copy.deepcopy, 0), (copy.deepcopy, 8), (lambda env: pickle.loads(pickle.dumps(env)), 3)],
)
def test_a_copy_goes_on_equally(made: Callable[[Any], Any], begun: int) -> None:
    env = gymnasium.make(
        "flipperctl.env:flipperctl/Flipper-v0",
        terrain="step",
        perception={"noise": 0.01},
        randomise={"sim": {"friction": (0.7, 1.3)}},
    )
    env.reset(seed=1)
    env.reset(options={"difficulty": 0.5})  # the generator has begun an episode before
    for action in ACTIONS[:begun]:
        env.step(action)
    other = made(env)
    assert other.unwrapped.spec == env.unwrapped.spec
    assert other.unwrapped.state.time == env.unwrapped.state.time
    assert went_on(other, ACTIONS) == went_on(env, ACTIONS)


def test_one_without_an_episode_is_copied_too() -> None:
    env = FlipperEnv("flat")
    assert not copy.deepcopy(env).running
    env.np_random = np.random.default_rng(3)
    other = copy.deepcopy(env)
    assert other.reset()[0].tobytes() == env.reset()[0].tobytes()


def test_an_episode_that_does_not_repeat_is_refused_with_what_to_use() -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    env.drive.decide(8)  # past the environment
    with pytest.raises(FlipperctlError, match=r"simulator\(\) is a copy of the scene"):
        copy.deepcopy(env)
