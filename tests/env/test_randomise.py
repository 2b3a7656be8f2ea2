"""Randomisation: the drawn values, their effect, and their entry in the episode's row."""

import math
from importlib.resources import files

import numpy as np
import pytest
import yaml

from flipperctl.api import Robot
from flipperctl.config import EnvConfig, resolver, to_dict, with_overrides
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.plugging import plugins
from flipperctl.rollout.episode import play

HOLD, RAISE = 4, 8
RANGES = {
    "sim": {"friction": [0.6, 1.2], "substep": [0.0025, 0.005], "iterations": [10, 40]},
    "robot": {
        "chassis_mass": [30, 40],
        "flipper_mass": [4, 6],
        "track_speed": [0.15, 0.25],
        "flipper_speed": [0.4, 0.5],
        "actuator_delay": [0.0, 0.1],
        "flipper_torque": [80, 200],
        "flipper_length": [0.52, 0.55],
        "track_radius": [0.097, 0.103],
    },
    "perception": {
        "noise": [0.0, 0.02],
        "dropout": [0.0, 0.2],
        "bias": [-0.02, 0.02],
        "horizon": [0.5, 1.0],
        "angle_noise": [0.0, 0.02],
        "pitch_bias": [-0.03, 0.03],
        "flipper_bias": [-0.03, 0.03],
        "delay": [0.0, 0.2],
    },
}


def config(**overrides: object) -> EnvConfig:
    plugins.load()
    return with_overrides(EnvConfig(terrain="step"), overrides)


def episode(seed: int, **overrides: object) -> dict[str, object]:
    return play(
        FlipperEnv(config=config(**overrides)),
        resolver.create("controller", "okada", "controller").build(),
        seed,
    )


def test_one_factor_scales_all_lengths_after_their_own_samples() -> None:
    lengths = {"flipper_length": [0.5, 0.5], "chassis_length": [0.8, 0.8], "size": [1.1, 1.1]}
    env = FlipperEnv(config=config(randomise={"robot": lengths}))
    env.reset(seed=0)
    found = env.robot.chassis_length, env.robot.flipper_length, env.robot.track_radius
    assert found == pytest.approx((0.88, 0.55, 0.11))
    assert env.robot.chassis_mass == 35.0
    assert env.config.robot == Robot()
    assert env.scene.robot == env.robot  # pictures show the one that drives
    with pytest.raises(ConfigError, match=r"randomise\.robot\.sise: .*did you mean 'size'"):
        config(randomise={"robot": {"sise": 1.1}})
    with pytest.raises(ConfigError, match="chassis_length"):
        config(randomise={"robot": {"size": [0.1, 1.0]}})


@pytest.mark.parametrize(("name", "sim"), [("widest", "planar"), ("widest_3d", "mujoco")])
def test_the_widest_conditions_are_possible_together(name: str, sim: str) -> None:
    text = files("flipperctl.configs.conditions").joinpath("widest.yaml").read_text()
    sections = yaml.safe_load(text)
    if name == "widest_3d":
        more = files("flipperctl.configs.conditions").joinpath(f"{name}.yaml").read_text()
        sections["randomise"]["sim"] |= yaml.safe_load(more)["randomise"]["sim"]
    env = FlipperEnv("midway", sim=sim, **sections)
    env.reset(seed=1)
    robot = env.robot
    assert 0.1 <= robot.track_speed <= 0.4
    assert 0.9 * 0.722 <= robot.chassis_length <= 1.1 * 0.798
    assert robot.track_force is not None
    assert robot.payload is not None
    assert 350 <= robot.track_force <= 700
    for _ in range(3):
        env.step(HOLD)


def test_every_range_names_a_setting_and_is_drawn_within() -> None:
    for seed in range(2):
        row = episode(seed, randomise=RANGES)
        for section, ranges in RANGES.items():
            for name, (low, high) in ranges.items():
                value = row[f"{section}.{name}"]
                assert isinstance(value, int if name == "iterations" else float)
                assert low <= value <= high
    assert episode(1, randomise=RANGES) == row
    assert episode(0, randomise=RANGES)["sim.friction"] != row["sim.friction"]


def test_a_drawn_value_acts_as_the_setting_itself() -> None:
    fixed = {
        "sim.friction": 0.7,
        "robot.chassis_mass": 50.0,
        "robot.track_speed": 0.15,
        "robot.actuator_delay": 0.12,
        "perception.noise": 0.01,
        "perception.bias": 0.02,
        "perception.delay": 0.2,
        "perception.pitch_bias": 0.05,
    }
    drawn = {f"randomise.{key}": [value, value] for key, value in fixed.items()}
    by_path = {f"randomise.{key}": value for key, value in fixed.items()}
    one, other, third = episode(3, **fixed), episode(3, **drawn), episode(3, **by_path)
    for row in (other, third):
        assert {name: row[name] for name in (*one, *fixed)} == {**one, **fixed}
    assert one["pitch_variation_decisions"] != episode(3)["pitch_variation_decisions"]


def test_a_sampled_substep_divides_the_sampling_time() -> None:
    found = config(randomise={"sim": {"substep": (0.0025, 0.005), "iterations": (10, 12)}})
    values = [found.sample(np.random.default_rng(seed)) for seed in range(40)]
    ratios = {round(0.01 / value["sim.substep"], 9) for value in values}
    assert ratios == {2.0, 3.0, 4.0}
    assert {value["sim.iterations"] for value in values} == {10, 11, 12}
    assert isinstance(values[0]["sim.iterations"], int)


def test_a_further_setting_leaves_the_samples_of_common_ones_alone() -> None:
    common = {"robot": {"track_speed": [0.15, 0.25]}, "perception": {"occlusion": 0.5}}
    further = {
        "robot": {**common["robot"], "chassis_length": [0.7, 0.8]},
        "perception": {**common["perception"], "density": [60, 90]},
    }
    for seed in range(5):
        one, more = (
            config(randomise=given).sample(np.random.default_rng(seed))
            for given in (common, further)
        )
        assert list(more) == [*one, "robot.chassis_length", "perception.density"]
        assert {name: more[name] for name in one} == one


def test_the_order_of_paths_and_none_do_not_matter() -> None:
    one = config(**{"randomise.sim.gravity": [9, 10], "randomise.sim.friction": [0.5, 1]})
    other = config(**{"randomise.sim.friction": [0.5, 1], "randomise.sim.gravity": [9, 10]})
    rng = np.random.default_rng
    assert one.sample(rng(1)) == other.sample(rng(1))
    dropped = with_overrides(
        one, {"randomise.sim.gravity": None, "randomise": {"sim": {"friction": None}}}
    )
    assert to_dict(dropped)["randomise"]["sim"] == {}
    assert with_overrides(one, {}) == one


def test_occlusion_is_on_with_its_probability() -> None:
    noise = {"randomise.perception.noise": [0, 0.02]}
    both = {**noise, "randomise.perception.occlusion": 0.5}
    env = FlipperEnv(config=config(**both))
    drawn = []
    for seed in range(20):
        env.reset(seed=seed)
        drawn.append(env.perception.filled is not None)
    assert 4 <= sum(drawn) <= 16  # 10 ± √5; each seed draws the same every time
    switched = next(seed for seed, on in enumerate(drawn) if on)
    row = episode(switched, **both)
    assert row["perception.occlusion"] == 1.0
    # sampled last, so that it leaves the other samples of a seed as they were
    assert row["perception.noise"] == episode(switched, **noise)["perception.noise"]


def test_drawing_leaves_terrain_and_start_alone() -> None:
    plain, drawn = FlipperEnv(config=config()), FlipperEnv(config=config(randomise=RANGES))
    for env in (plain, drawn):
        env.reset(seed=11)
    assert np.array_equal(plain.profile.points, drawn.profile.points)
    assert plain.state.position[0] == drawn.state.position[0]


def test_a_slower_flipper_does_not_change_the_decisions_period() -> None:
    env = FlipperEnv(config=config(**{"randomise.robot.flipper_speed": [0.2, 0.2]}))
    env.reset(seed=0)
    env.step(RAISE)
    assert env.state.time == pytest.approx(Robot().decision_period)
    assert env.state.front == pytest.approx(0.2 * 0.6, abs=0.01)
    seen = env.simulator().perceive_exactly().robot  # by teachers and planners
    assert (seen.flipper_speed, seen.decision_period) == (0.2, Robot().decision_period)


def test_a_delayed_flipper_begins_to_turn_later() -> None:
    env = FlipperEnv(config=config(**{"robot.actuator_delay": 0.3}))
    env.reset(seed=0)
    env.step(RAISE)
    assert env.state.front == pytest.approx(math.radians(25) * 0.3, abs=0.02)


def test_what_is_perceived_is_as_old_as_the_delay() -> None:
    env = FlipperEnv(config=config(**{"perception.delay": 0.3}))
    env.reset(seed=0)
    env.step(RAISE)
    seen = env.perception.front
    assert seen == pytest.approx(math.radians(25) * 0.3, abs=0.02)
    assert env.state.front == pytest.approx(math.radians(25) * 0.6, abs=0.02)
    whole = FlipperEnv(config=config(**{"robot.control_period": 0.5, "perception.delay": 0.5}))
    whole.reset(seed=0)
    before = whole.state.front
    whole.step(RAISE)
    assert whole.perception.front == before  # as at the beginning of the decision


def test_a_bias_shifts_what_is_perceived_and_nothing_else() -> None:
    plain, biased = (
        FlipperEnv(config=config(**more))
        for more in (
            {},
            {
                "perception.bias": 0.03,
                "perception.pitch_bias": 0.1,
                "perception.flipper_bias": -0.05,
            },
        )
    )
    one, other = (env.reset(seed=2)[0] for env in (plain, biased))
    assert other[:-3] - one[:-3] == pytest.approx(0.03)
    assert other[-3:] - one[-3:] == pytest.approx([-0.05, -0.05, 0.1])
    assert plain.state.pitch == biased.state.pitch


@pytest.mark.parametrize(
    ("ranges", "words"),
    [
        ({"sim": {"friction": [1.2, 0.6]}}, r"^randomise\.sim\.friction: .*low ≤ high"),
        ({"sim": {"friction": [0.5, 20]}}, r"^randomise\.sim\.friction: 20.0 is not allowed .*10"),
        ({"sim": {"frictoin": [0.5, 1]}}, r"^randomise\.sim\.frictoin: sim=planar.*'friction'"),
        ({"friction": [0.5, 1]}, r"^randomise\.friction: there is no such key; .*robot, sim"),
        ({"perception": {"dropout": [-0.5, 0.5]}}, r"^randomise\.perception\.dropout: .*-0\.5"),
        ({"perception": {"occlusion": 1.5}}, r"^randomise\.perception\.occlusion: .*1\.5"),
        ({"robot": {"track_radius": [0.1, 0.4]}},
         r"^randomise\.robot\.track_radius: chassis_length \(0\.76 m\) "),
        ({"robot": {"flipper_length": [0.21, 0.5], "track_radius": [0.08, 0.12]}},
         r"^randomise\.robot\.flipper_length, randomise\.robot\.track_radius: flipper_length "),
        ({"robot": {"flipper_length": [0.19, 0.5]}}, r": 0\.19 is not allowed .*> 0\.2"),
        ({"sim": {"substep": [0.00041, 0.005]}}, None),  # a divisor of 0.01 s beside it
        ({"sim": {"substep": [0.0003, 0.005]}}, r"^randomise\.sim\.substep: .*> 0\.0004"),
        ({"robot": {"actuator_delay": [0, 0.5]}, "perception": {"delay": [0.1, 0.5]}}, None),
        ({"robot": {"track_speed": [0.001, 0.2]}}, r"^episode\.stuck_progress: .*0\.001 m/s"),
        ({"robot": {"angle_step": 0.2}}, r"^randomise\.robot\.angle_step: policies rely on it"),
        ({"perception": {"occlusion": [0, 1]}}, r"^randomise\.perception\.occlusion: a prob"),
    ],
)  # fmt: skip
def test_a_wrong_range_is_one_clear_error(ranges: dict[str, object], words: str | None) -> None:
    if words is None:
        config(randomise=ranges)
        return
    with pytest.raises(ConfigError, match=words) as error:
        config(randomise=ranges)
    assert "\n" not in str(error.value)


def test_a_setting_without_a_number_is_an_error_that_names_those_with_one() -> None:
    with pytest.raises(ConfigError, match=r"^randomise\.sim\.view: it is neither .*friction"):
        config(sim="mujoco", randomise={"sim": {"view": [0.5, 1]}})


def test_every_sampled_robot_is_possible() -> None:
    # The ends are possible together with each other, whatever the robot's own values.
    found = config(
        randomise={"robot": {"flipper_length": [0.21, 0.5], "track_radius": [0.05, 0.1]}}
    )
    for seed in range(50):
        drawn = found.sample(np.random.default_rng(seed))
        _, robot, _ = found.with_sampled_values(drawn)
        assert robot.flipper_axle > 0
        assert Robot(**robot.model_dump()) == robot


def test_a_sampled_value_is_validated_beside_the_others() -> None:
    with pytest.raises(ConfigError, match=r"^randomise\.robot\.track_radius: chassis_length"):
        config().with_sampled_values({"robot.track_radius": 0.45, "robot.flipper_length": 1.5})


def test_a_delay_must_fit_into_a_decision() -> None:
    with pytest.raises(ConfigError, match=r"actuator_delay: 0\.4 s is longer than a decision"):
        config(**{"robot.angle_step": 0.1, "randomise.robot.actuator_delay": [0.0, 0.4]})
