"""The weighted sum of reward terms, and what a term may not return.

Potential-based shaping changes no optimal policy (Ng, Harada and Russell 1999).
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    RobotGeometry,
    RobotState,
    Shaping,
    Transition,
    Transitions,
    registry,
    reward,
)
from flipperctl.config import EnvConfig, TrainConfig, resolver, with_overrides
from flipperctl.config.reward_sum import RewardSum
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError, NonFiniteError, PluginError, PluginFailedError


def transition(time: float = 0.6, outcome: Outcome | None = None, pitch: float = 0.0) -> Transition:
    state = RobotState(np.zeros(2), pitch, 0.0, 0.0, np.zeros(2), 0.0, time)
    ground, robot = Profile([(0.0, 0.0)]), RobotGeometry()
    return Transition(state, state, np.zeros(2), (0, 0), ground, robot, outcome)


TWO = Transitions.of([transition(0.6), transition(1.2, Outcome.REACHED, pitch=0.3)])


def term(name: str, **settings: Any) -> RewardTerm:
    made = resolver.create("reward", {"name": name, **settings}, f"rewards.{name}")
    assert isinstance(made, RewardTerm)
    return made


def test_each_part_is_weighted_and_kept_apart() -> None:
    half, twice = (term("end", settlement=10.0, weight=w) for w in (0.5, -2.0))
    parts = RewardSum({"a": half, "b": twice})
    assert parts(transition(outcome=Outcome.REACHED)) == {"a": 5.0, "b": -20.0}


@pytest.mark.usefixtures("registry")
def test_the_sum_of_many_adds_terms_with_and_without_an_array_form() -> None:
    @reward("tilt")
    class Tilt(RewardTerm):
        """The pitch, of one decision at a time."""

        def __call__(self, t: Transition) -> float:
            return t.after.pitch

    found = RewardSum({"end": term("end", weight=0.5), "tilt": term("tilt", weight=2.0)})
    assert found.array(TWO) == pytest.approx([0.0, 5.6])
    assert [sum(found(t).values()) for t in TWO] == pytest.approx([0.0, 5.6])
    assert RewardSum({}).array(TWO).tolist() == [0.0, 0.0]


def summed(form: Callable[[Transitions], Any], weight: float = 1.0) -> RewardSum:
    """Return the sum of a term whose array form is that."""

    @reward("odd")
    class Odd(RewardTerm):
        """A term that computes many decisions at once."""

        bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

        def __call__(self, t: Transition) -> float:
            return 0.0

        def array(self, ts: Transitions) -> Any:
            return form(ts)

    return RewardSum({"odd": term("odd", weight=weight)})


@pytest.mark.parametrize(
    ("form", "error", "words"),
    [
        (lambda ts: [0.0, 0.0], PluginFailedError, ["returned [0.0, 0.0]", "shape (2,)"]),
        (lambda ts: np.zeros(3), PluginFailedError, ["shape (3,)", "shape (2,) is allowed"]),
        (lambda ts: np.array([None, 0]), PluginFailedError, ["an array of object"]),
        (lambda ts: np.array([0.0, np.nan]), NonFiniteError, ["returned nan at time 1.20 s"]),
        (lambda ts: np.array([-np.inf, 0.0]), NonFiniteError, ["returned -inf at time 0.60 s"]),
        (lambda ts: np.array([-1.0, 0.5]), PluginFailedError, ["0.5 at time 1.20 s", "-1 to 0"]),
    ],
)
@pytest.mark.usefixtures("registry")
def test_an_array_form_that_fails_is_named(
    form: Callable[[Transitions], Any], error: type[Exception], words: list[str]
) -> None:
    with pytest.raises(error) as found:
        summed(form).array(TWO)
    text = str(found.value)
    assert "\n" not in text
    for word in ("'odd'", "rewards.odd", "array", f"{Path(__file__).name}:", *words):
        assert word in text, text


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (lambda: -1.0 - 1e-12, None, ""),  # rounding
        (lambda: 0.5, PluginFailedError, r"returned 0\.5 at time 0\.60 s .* from -1 to 0 is"),
        (lambda: np.float64("nan"), NonFiniteError, "returned nan at time 0.60 s"),
        (lambda: "x", PluginFailedError, "__call__ returned 'x' at time 0.60 s as rewards.odd"),
    ],
)
@pytest.mark.usefixtures("registry")
def test_a_value_of_one_decision_that_fails_is_named(
    value: Callable[[], Any], error: type[Exception] | None, text: str
) -> None:
    @reward("odd")
    class Odd(RewardTerm):
        """A term that computes one decision."""

        bounds: ClassVar[tuple[float, float]] = (-1.0, 0.0)

        def __call__(self, t: Transition) -> float:
            return value()

    found = RewardSum({"odd": term("odd")})
    if error is None:
        assert found(transition())["odd"] == value()
        return
    with pytest.raises(error, match=text) as raised:
        found(transition())
    assert f"{Path(__file__).name}:" in str(raised.value)


@pytest.mark.usefixtures("registry")
def test_a_term_says_what_a_prediction_lacks() -> None:
    @reward("remaining")
    class Remaining(RewardTerm):
        """A term of the ground's last edge."""

        not_predicted: ClassVar[str] = "the last edge"

        def __call__(self, t: Transition) -> float:
            return t.profile.end

    terms = {"end": term("end"), "far": term("remaining")}
    assert RewardSum(terms).not_predicted == {"far": "the last edge"}
    Remaining.not_predicted = 3
    with pytest.raises(PluginError, match=r"rewards.far: reward 'remaining': not_predicted is 3"):
        _ = RewardSum(terms).not_predicted


def test_a_window_longer_than_searches_remember_is_not_predicted() -> None:
    by_window = {n: registry["reward", "pitch"](window=n) for n in (8, 9)}
    assert RewardSum({"pitch": by_window[8]}).not_predicted == {}
    with pytest.raises(ConfigError, match=r"rewards\.pitch: a search .* a window of 9 pitches; 8"):
        RewardSum({"pitch": by_window[9]}).require_predictable("rewards")


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
