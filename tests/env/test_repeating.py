"""Plugins that draw random numbers of their own are refused before their episodes are compared."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Controller, Perception, Profile, RewardTerm, Terrain, Transition
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.errors import PluginFailedError
from flipperctl.policies.controllers import plugin_policy
from flipperctl.testing.recorded import NoReward

own = np.random.default_rng(0)
HOLD = 4


class Bump(Terrain):
    """A ridge of a height that is drawn anywhere."""

    plugin_name = "bump"
    draw: Callable[[np.random.Generator], float]

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the ridge."""
        return Profile([(0, 0), (0.3, 0.05 + 0.05 * self.draw(rng)), (0.6, 0)])


class Drawn(RewardTerm):
    """A reward that is drawn anywhere."""

    plugin_name = "drawn"
    draw: Callable[[], float]

    def __call__(self, t: Transition) -> float:
        """Return the number."""
        return self.draw()


class Dice(Controller):
    """Rolls dice."""

    plugin_name = "dice"

    def act(self, p: Perception) -> int:
        """Return any action."""
        return random.randrange(9)


def environment(terrain: Callable[[Any], float], reward: Callable[[], float] | None) -> FlipperEnv:
    term = NoReward() if reward is None else Drawn(draw=reward)
    return FlipperEnv(config=EnvConfig(terrain=Bump(draw=terrain), rewards={"drawn": term}))


def test_what_draws_from_its_generator_repeats_and_leaves_the_user_s_alone() -> None:
    env, state = environment(lambda rng: rng.random(), None), random.getstate()
    require_repeatable(env, 0)
    for _ in range(2):  # the user's own draws between the calls are no fault
        np.random.rand()  # noqa: NPY002
        env.step(HOLD)
    assert random.getstate() == state


@pytest.mark.parametrize(
    ("terrain", "reward", "text"),
    [
        (lambda rng: np.random.rand(), None, "^terrain 'bump': uses numpy.random in generate"),  # noqa: NPY002
        (lambda rng: own.random(), None, "^terrain 'bump': .*the seed 0 differ in their ground"),
        (lambda rng: 0.0, random.random, "^reward 'drawn': uses random in a decision"),
        (lambda rng: 0.0, own.random, "^reward 'drawn': .*differ in their rewards of decision 0"),
        (lambda rng: own.random(), own.random, "^terrain 'bump': .*differ in their ground"),
    ],
)
def test_random_numbers_from_elsewhere_are_refused(
    terrain: Callable[[Any], float], reward: Callable[[], float] | None, text: str
) -> None:
    with pytest.raises(PluginFailedError, match=text):
        require_repeatable(environment(terrain, reward), 0)


def test_a_controller_that_draws_from_elsewhere_is_refused() -> None:
    env = environment(lambda rng: 0.0, None)
    env.reset(seed=0)
    with pytest.raises(PluginFailedError, match=r"^controller 'dice': uses random in act"):
        plugin_policy(Dice()).act(env.perception)


def test_what_is_handed_out_is_the_caller_s() -> None:
    def episode(change: bool) -> list[bytes]:
        env, found = FlipperEnv("stair", perception={"occlusion": True}), []
        observation, _ = env.reset(seed=3)
        for _ in range(4):
            kept = env.perception.recent[-1].tobytes()
            if change:
                observation[:] = np.nan
            found.append(env.perception.observation.tobytes())
            assert found[-1] == kept
            if change:
                p = env.perception
                for array in (p.observation, p.points, p.filled, p.seen, p.position, p.deviation):
                    if array is not None:
                        array[:] = 0
            observation, reward, *_, info = env.step(HOLD)
            found += [observation.tobytes(), repr(reward).encode()]
            found += [old.tobytes() for old in env.perception.recent]
            if change:
                info["rewards"].clear()
        return found

    assert episode(True) == episode(False)
