"""The array form of each built-in reward term equals its other form at poses of every kind."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    Robot,
    RobotGeometry,
    RobotStates,
    Transitions,
    registry,
)
from flipperctl.config import resolver

COUNT, PITCHES, POSES = 400, 8, 20
BUILT_IN = [
    name
    for (kind, name), cls in registry.items()
    if kind == "reward" and cls.__module__.startswith("flipperctl_plugins.")
]
STAIR = Profile([(0, 0), (0, 0.15), (0.3, 0.15), (0.3, 0.3), (0.6, 0.3), (0.6, 0.1), (1.0, 0)])


def states(rng: np.random.Generator) -> RobotStates:
    """Return poses on, above and in the ground, also far from the obstacle."""
    x = rng.uniform(-1, 1.5, COUNT)
    x[:20] *= 4
    return RobotStates(
        position=np.column_stack([x, STAIR.heights(x) + rng.uniform(0.05, 0.3, COUNT)]),
        pitch=rng.uniform(-0.9, 0.9, COUNT),
        front=rng.uniform(-1, 1, COUNT),
        rear=rng.uniform(-1, 1, COUNT),
        velocity=rng.normal(size=(COUNT, 2)) / 10,
        pitch_rate=rng.normal(size=COUNT),
        time=rng.uniform(0, 20, COUNT),
    )


@pytest.fixture(scope="module")
def ts() -> Transitions:
    rng = np.random.default_rng(5)
    steps = rng.normal(size=(COUNT, POSES, 3)) * [0.01, 0.001, 0.01]
    return Transitions(
        before=states(rng),
        after=states(rng),
        pitches=np.cumsum(rng.normal(size=(COUNT, PITCHES)) / 10, axis=1),
        action=rng.integers(-1, 2, (COUNT, 2)),
        previous_action=rng.integers(-1, 2, (COUNT, 2)),
        path=np.cumsum(steps, axis=1),
        flippers=np.zeros((COUNT, POSES, 2)),
        profile=STAIR,
        robot=RobotGeometry(),
        outcome=tuple(rng.choice(np.array([None, *Outcome], dtype=object), COUNT)),
    )


@pytest.mark.parametrize("spec", [*BUILT_IN, {"name": "swing", "at_decisions": True}], ids=str)
def test_both_forms_are_equal(spec: str | dict[str, Any], ts: Transitions) -> None:
    term = resolver.create("reward", spec, "rewards")
    assert isinstance(term, RewardTerm)
    expected = np.array([term(t) for t in ts])
    assert term.array(ts) == pytest.approx(expected, abs=1e-12)
    assert len(set(expected.tolist())) > 2  # the poses tell terms apart


def test_stability_is_equal_in_both_forms_with_a_load(ts: Transitions) -> None:
    term = resolver.create("reward", "stability", "rewards")
    assert isinstance(term, RewardTerm)
    loaded = replace(ts, robot=Robot(payload=60, payload_x=0.2, payload_z=0.4))
    assert term.array(loaded) == pytest.approx(np.array([term(t) for t in loaded]), abs=1e-12)
    bare = term.array(replace(ts, robot=Robot()))
    assert np.array_equal(bare, term.array(ts))  # bit for bit
    assert (term.array(loaded) != bare).any()


# Limits at which rounding decides, and a robot that lies upon its limit
@pytest.mark.parametrize(
    ("name", "settings"),
    [("clearance", {"bump": 0.0}), ("stability", {"touch": 1e-300}), ("flipper", {"near": 0.0})],
)
@pytest.mark.parametrize("pitch", [0.0, 0.3])
def test_a_limit_counts_in_both_forms(
    name: str, settings: dict[str, float], pitch: float, ts: Transitions
) -> None:
    term = resolver.create("reward", {"name": name, **settings}, "rewards")
    assert isinstance(term, RewardTerm)
    slope = Profile([(-5.0, -5 * np.tan(pitch)), (5.0, 5 * np.tan(pitch))])
    x = np.round(np.linspace(-2, 2, COUNT), 2)
    after = RobotStates(
        **{
            **{key: getattr(ts.after, key) for key in ("velocity", "pitch_rate", "time")},
            "position": np.column_stack([x, x * np.tan(pitch) + 0.1 / np.cos(pitch)]),
            "pitch": np.full(COUNT, pitch),
            "front": np.zeros(COUNT),
            "rear": np.zeros(COUNT),
        }
    )
    fields = {field: getattr(ts, field) for field in Transitions.__dataclass_fields__}
    resting = Transitions(**{**fields, "after": after, "profile": slope})
    assert term.array(resting) == pytest.approx(np.array([term(t) for t in resting]), abs=1e-9)
