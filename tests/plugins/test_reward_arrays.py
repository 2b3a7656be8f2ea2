"""A built-in reward term computes many decisions at once as it computes one, bit for bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import (
    Outcome,
    Profile,
    RewardTerm,
    Robot,
    RobotStates,
    Transitions,
    registry,
)
from flipperctl.config import resolver

COUNT, PITCHES, POSES = 200, 8, 20
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
        robot=Robot(payload=60, payload_x=0.2, payload_z=0.4),
        outcome=tuple(rng.choice(np.array([None, *Outcome], dtype=object), COUNT)),
    )


@pytest.mark.parametrize("spec", [*BUILT_IN, {"name": "swing", "at_decisions": True}], ids=str)
def test_many_decisions_are_as_one(spec: str | dict[str, Any], ts: Transitions) -> None:
    term = resolver.create("reward", spec, "rewards")
    assert isinstance(term, RewardTerm)
    each = [term(t) for t in ts]
    assert all(isinstance(value, float) for value in each)
    assert term.array(ts).tolist() == each
    assert len(set(each)) > 2  # the poses tell terms apart
    no_path = replace(ts, path=ts.path[:, :0], flippers=ts.flippers[:, :0])
    assert term.array(no_path).tolist() == [term(t) for t in no_path]
