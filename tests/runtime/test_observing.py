"""From what a robot measures to the observation: as in the environment, bit for bit."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.core.observation import to_level
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError, NonFiniteError, PolicyError
from flipperctl.runtime import OnnxPolicy
from tests.runtime.linear import write

GROUND = np.column_stack([np.linspace(-2.0, 2.0, 81), np.full(81, -0.1)])
ANGLES = {"front": 0.3, "rear": -0.2, "pitch": 0.1}


@pytest.fixture
def policy(tmp_path: Path) -> OnnxPolicy:
    return OnnxPolicy(write(tmp_path / "p.onnx"))


@pytest.mark.parametrize("sensing", [{}, {"occlusion": True, "dropout": 0.2}], ids=str)
def test_it_is_the_environment_s_own(policy: OnnxPolicy, sensing: dict[str, Any]) -> None:
    env = FlipperEnv("stair", perception=sensing)
    env.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        p = env.perception
        points = np.concatenate([p.points, [[-1.2, 9.0], [3.0, 9.0]]])  # two beyond the bins
        found = policy.observation(points, front=p.front, rear=p.rear, pitch=p.pitch)
        assert found.dtype == np.float32
        assert found.tolist() == p.observation.tolist()
        env.step(int(rng.integers(9)))


def test_points_of_the_chassis_frame_are_levelled(policy: OnnxPolicy) -> None:
    fixed = to_level(GROUND, -ANGLES["pitch"])
    found = policy.observation(fixed, **ANGLES, frame="R")
    assert found == pytest.approx(np.array([-0.1] * 15 + [0.3, -0.2, 0.1]), abs=1e-6)
    assert policy.act(found) == 0


@pytest.mark.parametrize(
    ("points", "frame", "error", "text"),
    [
        ([[0.0, 0.0, 0.0]], "L", PolicyError, r"shape \(1, 3\); \(P, 2\) is allowed"),
        (np.empty((0, 2)), "L", PolicyError, r"none of the 0 points lies within ±1\.125 m"),
        ([[500.0, -10.0]], "L", PolicyError, "none of the 1 points lies within"),
        ([[0.0, -0.1], [0.1, math.nan]], "L", NonFiniteError, r"point 1 is \(0\.1, nan\)"),
        (["far"], "L", PolicyError, "the points are not numbers"),
        (GROUND, "W", PolicyError, "no frame 'W'; 'L'"),
    ],
)
def test_points_that_are_none_are_refused(
    policy: OnnxPolicy, points: Any, frame: Any, error: type[FlipperctlError], text: str
) -> None:
    with pytest.raises(error, match=text) as caught:
        policy.observation(points, **ANGLES, frame=frame)
    assert str(caught.value).startswith(str(policy.path))


def test_an_angle_that_is_not_known_is_refused(policy: OnnxPolicy) -> None:
    with pytest.raises(NonFiniteError, match="pitch is nan"):
        policy.observation(GROUND, front=0.0, rear=0.0, pitch=math.nan, frame="R")
    missing: Any = None
    with pytest.raises(PolicyError, match="front is None; a number is allowed"):
        policy.observation(GROUND, front=missing, rear=0.0, pitch=0.0)


def test_an_angle_may_be_any_single_number(policy: OnnxPolicy) -> None:
    expected = policy.observation(GROUND, front=0.5, rear=0.0, pitch=0.0)
    for front in (np.array(0.5), np.float32(0.5)):
        found = policy.observation(GROUND, front=front, rear=0.0, pitch=0.0)
        assert found.tolist() == expected.tolist()
    with pytest.raises(PolicyError, match=r"front is .*; a number is allowed"):
        policy.observation(GROUND, front=np.zeros(2), rear=0.0, pitch=0.0)
