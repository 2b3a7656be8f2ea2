"""``randomise``: which values of a range an episode gets, and how far from the configured ones."""

from typing import Any

import numpy as np
import pytest

from flipperctl.config import EnvConfig, Randomise
from flipperctl.errors import ConfigError

RANGES: dict[str, Any] = {
    "sim": {"friction": (0.4, 1.2)},
    "perception": {"noise": (0.005, 0.02), "horizon": (0.8, 1.0), "occlusion": 0.5},
    "robot": {"size": (0.9, 1.1), "payload": (0.0, 10.0), "track_force": (350.0, 700.0)},
}
"""Of settings that are configured inside the range, below and above it, as null, or as a switch."""
CONFIGURED = {
    "sim.friction": 1.0,
    "perception.noise": 0.005,
    "perception.horizon": 1.0,
    "perception.occlusion": 0.0,
    "robot.size": 1.0,
    "robot.payload": 0.0,
    "robot.track_force": 700.0,  # null is no limit
}


def samples(spread: Any, count: int = 200) -> list[dict[str, float]]:
    config = EnvConfig(terrain="flat", randomise=Randomise(**RANGES, spread=spread))
    rng = np.random.default_rng(0)
    return [config.sample(rng) for _ in range(count)]


def test_none_of_the_way_is_the_configured_robot_as_far_as_the_ranges_allow() -> None:
    for found in samples((0, 0), 20):
        assert found == pytest.approx(CONFIGURED)


def test_the_whole_way_is_the_whole_range() -> None:
    found = samples((1, 1))
    for name, low, high in (("sim.friction", 0.4, 1.2), ("perception.noise", 0.005, 0.02)):
        values = [one[name] for one in found]
        assert low <= min(values) < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < max(values) <= high
    assert 0.35 < np.mean([one["perception.occlusion"] for one in found]) < 0.65


def test_one_share_holds_for_all_settings_of_an_episode() -> None:
    half = samples((0.5, 0.5))
    assert all(0.7 <= one["sim.friction"] <= 1.1 and one["robot.payload"] <= 5 for one in half)
    assert max(one["sim.friction"] for one in half) > 1.08
    assert 0.15 < np.mean([one["perception.occlusion"] for one in half]) < 0.35
    found = samples((0, 1), 2000)
    names = ("sim.friction", "robot.payload", "robot.track_force")
    far = np.array([[abs(one[name] - CONFIGURED[name]) for name in names] for one in found])
    assert (np.corrcoef(far.T) > 0.1).all()  # independent ranges have none


@pytest.mark.parametrize("wrong", [(-0.1, 1), (0, 1.5), (0.7, 0.2)])
def test_other_shares_are_refused(wrong: tuple[float, float]) -> None:
    with pytest.raises((ConfigError, ValueError), match=r"than or equal to|low ≤ high"):
        Randomise(spread=wrong)


def test_a_number_up_to_which_an_engine_samples_lies_on_the_way_too() -> None:
    ranges = Randomise(sim={"yaw": 0.1, "offset": 0.05, "friction": None}, spread=(0.5, 0.5))
    config = EnvConfig(terrain="flat", sim="mujoco", randomise=ranges)
    found = config.sample(np.random.default_rng(0))
    assert (found["sim.yaw"], found["sim.offset"]) == pytest.approx((0.05, 0.025))


def test_a_range_over_a_factor_of_ten_is_sampled_in_the_logarithm() -> None:
    def torques(low: float, **spread: Any) -> list[float]:
        ranges = Randomise(robot={"flipper_torque": (low, 200)}, **spread)
        config, rng = EnvConfig(terrain="flat", randomise=ranges), np.random.default_rng(0)
        return [config.sample(rng)["robot.flipper_torque"] for _ in range(4000)]

    for low, quarter in ((20, 35.6), (20.5, 65.4)):  # 20 · 10^0.25, 20.5 + 44.9
        found = torques(low)
        assert low <= min(found) < max(found) <= 200
        assert np.mean(np.array(found) < quarter) == pytest.approx(0.25, abs=0.03)
    half = torques(20, spread=(0.5, 0.5))
    assert 63.2 <= min(half) < 64  # 200 / √10: half of the way from the configured torque
