"""The measures of ``examples/mapping.py`` against numbers worked by hand."""

from pathlib import Path

import pytest

from flipperctl import plugins
from flipperctl.env.flipper_env import FlipperEnv

EXAMPLE = Path(__file__).parents[2] / "examples" / "mapping.py"


def measured(**perception: object) -> dict[str, float]:
    env = FlipperEnv("flat", perception=perception)
    env.reset(seed=1)
    while True:
        *_, terminated, truncated, info = env.step(4)
        if terminated or truncated:
            found: dict[str, float] = info["metrics"]
            return found


@pytest.fixture(autouse=True)
def _loaded(registry: dict) -> None:
    plugins.load([EXAMPLE])


def test_a_constant_error_of_the_heights_is_the_map_error() -> None:
    found = measured(name="planar", bias=0.03)
    assert found["map_error"] == pytest.approx(0.03, abs=1e-3)
    assert (found["drift"], found["unseen"]) == (0.0, 0.0)


def test_belts_that_are_measured_too_fast_drift() -> None:
    none = {"noise": 0.0, "range_bias": 0.0, "tilt_wander": 0.0, "tilt_noise": 0.0}
    exact = measured(name="lidar", pose="belts", azimuths=60, belt_error=0.0, **none)
    assert exact["drift"] < 0.02
    assert 0.0 < exact["unseen"] < 0.6
    wrong = measured(name="lidar", pose="belts", azimuths=60, belt_error=0.2, **none)
    assert wrong["drift"] > exact["drift"] + 0.02
