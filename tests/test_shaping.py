"""Potential-based shaping changes no optimal policy (Ng, Harada and Russell 1999)."""

from typing import Any, ClassVar

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RobotGeometry,
    RobotState,
    Shaping,
    Transition,
)
from flipperctl.config import EnvConfig, TrainConfig, resolver, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError

GAMMA = 0.9
STATES, ACTIONS = 6, 3  # and behind the states one end
FLAT = Profile([(0.0, 0.0)])


class Table(Shaping):
    """Φ by number of the state, which is the chassis' x."""

    plugin_name: ClassVar[str] = "table"
    phi: tuple[float, ...] = ()

    def potential(self, state: RobotState, profile: Profile, robot: RobotGeometry) -> float:
        """Return the entry of the state."""
        return self.phi[int(state.position[0])]


def at(number: int) -> RobotState:
    return RobotState(np.array([number, 0.0]), 0.0, 0.0, 0.0, np.zeros(2), 0.0, 0.0)


def shaping(term: Shaping) -> np.ndarray:
    """Return the shaping (STATES, STATES + 1) by state and next state, the last of them the end."""

    def one(s: int, after: int) -> float:
        outcome = Outcome.REACHED if after == STATES else None
        return term(
            Transition(at(s), at(after), np.zeros(2), (0, 0), FLAT, RobotGeometry(), outcome)
        )

    return np.array([[one(s, after) for after in range(STATES + 1)] for s in range(STATES)])


def solved(chance: np.ndarray, pay: np.ndarray) -> np.ndarray:
    """Return Q* (STATES, ACTIONS); chance and pay are (STATES, ACTIONS, STATES + 1)."""
    q = np.zeros((STATES, ACTIONS))
    for _ in range(400):  # 0.9^400 = 5e-19
        value = np.append(q.max(axis=1), 0.0)
        q = (chance * (pay + GAMMA * value)).sum(axis=2)
    return q


@pytest.mark.parametrize("seed", range(3))
def test_a_shaped_task_has_the_optimal_policy_of_the_task(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chance = rng.dirichlet(np.full(STATES + 1, 0.5), (STATES, ACTIONS))
    pay = rng.normal(size=(STATES, ACTIONS, STATES + 1))
    phi = rng.normal(0.0, 10.0, STATES + 1)
    q = solved(chance, pay)

    def shaped(gamma: float) -> np.ndarray:
        term = Table(phi=tuple(phi.tolist()), gamma=gamma)
        return solved(chance, pay + shaping(term)[:, None, :])

    assert np.allclose(shaped(GAMMA), q - phi[:STATES, None])
    assert np.array_equal(shaped(GAMMA).argmax(axis=1), q.argmax(axis=1))
    # What makes it so is the discount: with another one the best actions change.
    assert not np.array_equal(shaped(0.5).argmax(axis=1), q.argmax(axis=1))


def episode(seed: int, **settings: Any) -> list[Transition]:
    """Play one episode on the stair with random actions; return its transitions."""
    env = FlipperEnv(config=with_overrides(EnvConfig(terrain="stair"), settings))
    env.reset(seed=seed)
    rng, transitions, over = np.random.default_rng(seed), [], False
    while not over:
        *_, terminated, truncated, _ = env.step(int(rng.integers(9)))
        over = terminated or truncated
        transitions.append(env.transition)
    return transitions


def discounted(parts: list[float]) -> float:
    """Return the discounted sum of one value per decision."""
    return float(np.dot(parts, GAMMA ** np.arange(len(parts))))


# The shaping telescopes along the robot's real trajectory, so that no policy gains by it.
def test_shaping_adds_up_to_the_potential_of_the_start() -> None:
    """It does so for each outcome, including a timeout."""
    term = resolver.create("reward", {"name": "shaped_progress", "gamma": GAMMA}, "rewards.s")
    assert isinstance(term, Shaping)
    ends = set()
    for settings in ({}, {"episode.slack": 1.01}, {"episode.stuck_progress": 2.0}):
        transitions = episode(1, **settings)
        ends.add(transitions[-1].outcome)
        parts = [term(t) for t in transitions]
        first = transitions[0]
        start = term.potential(first.before, first.profile, first.robot)
        assert start < -0.1
        assert discounted(parts) == pytest.approx(-start, abs=1e-12)
    assert {Outcome.TIMEOUT, Outcome.STUCK} <= ends


# Training checks what the proof needs.
SHAPED = {"rewards.way": {"name": "shaped_progress"}}


def train(**settings: Any) -> TrainConfig:
    base = TrainConfig(terrain="stair", network="at_d3qn")
    return with_overrides(base, {**SHAPED, **settings})


def test_the_shaping_s_discount_is_the_agent_s() -> None:
    assert train(**{"agent.gamma": 0.95, "rewards.way.gamma": 0.95}).agent.gamma == 0.95


def test_shaping_refuses_bootstrapped_outcomes() -> None:
    with pytest.raises(ConfigError) as error:
        train(**{"agent.bootstrap_outcomes": ["timeout"]})
    for text in ("agent.bootstrap_outcomes: ", "rewards.way", "agent.bootstrap_outcomes=[]"):
        assert text in str(error.value)
