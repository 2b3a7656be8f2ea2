"""Sensors with instruments, observers of an episode's samples, and the simulator of its scene."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl import api
from flipperctl.core.sensing import Measured, SensedAngles, SensedGround
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.perceiving import initial_copy
from flipperctl.env.pictures import Observer
from flipperctl.errors import ConfigError, NonFiniteError, PluginFailedError
from flipperctl.plugging import plugins

EXAMPLES = Path(__file__).parents[2] / "examples"
UP = api.action_index(1, 1)


@dataclass(frozen=True)
class Time:
    seconds: float


class Clock(api.Instrument):
    def __init__(self, period: float | None) -> None:
        self.period = period

    def measure(self, state: api.RobotState, rng: np.random.Generator) -> object:
        return Time(state.time + 1e-3 * rng.random())


class Ages:
    """An estimator whose angles are the newest times of three clocks."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}

    def update(self, measured: Measured) -> None:
        assert measured.time >= self.times.get(measured.instrument, 0.0)
        self.times[measured.instrument] = measured.time

    def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
        fast, slow, last = (self.times[name] for name in ("fast", "slow", "decision"))
        ground = SensedGround(np.zeros((0, 2)), np.full(api.ObservationLayout().heights, time))
        return ground, SensedAngles(front=fast, rear=slow, pitch=last)

    def save(self) -> dict[str, float]:
        return dict(self.times)

    def load(self, saved: dict[str, float]) -> None:
        self.times = dict(saved)


class Clocks(api.Sensor):
    """Three clocks."""

    def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
        return {"fast": Clock(0.01), "slow": Clock(0.25), "decision": Clock(None)}

    def estimator(self, robot: api.RobotGeometry) -> api.Estimator:
        return Ages()


class Log(Observer):
    def __init__(self) -> None:
        self.taken: list[Measured] = []
        self.times: list[float] = []
        self.poses: list[np.ndarray] = []
        self.order: list[str] = []

    def at(self, instrument: str) -> list[float]:
        return [m.time for m in self.taken if m.instrument == instrument]

    def begin(self, profile: api.Profile, robot: api.Robot) -> None:
        self.order.append("begin")

    def moved(self, time: float, poses: np.ndarray) -> None:
        self.times += [time + 0.01 * i for i in range(len(poses))]
        self.poses.append(poses)

    def measured(self, measured: Measured) -> None:
        self.taken.append(measured)

    def decided(self, t: api.Transition, p: api.Perception, rewards: Mapping[str, float]) -> None:
        self.order.append(f"{t.before.time:.1f} {p.pitch:.2f} {sorted(rewards)}")


@pytest.fixture
def clocks(registry: dict) -> type[api.Sensor]:
    return api.sensor("clocks")(Clocks)


def seen(p: api.Perception) -> tuple[float, ...]:
    return float(p.observation[0]), p.front, p.rear, p.pitch


@pytest.mark.usefixtures("clocks")
def test_instruments_measure_at_their_samples_and_estimates_are_as_old_as_the_delay() -> None:
    plain, env, log = FlipperEnv("step"), FlipperEnv("step", perception="clocks"), Log()
    late = FlipperEnv("step", perception={"name": "clocks", "delay": 0.12})
    env.observers = (log,)
    for one in (plain, env, late):
        one.reset(seed=1)
    assert seen(env.perception) == (0.0, 0.0, 0.0, 0.0)
    for decision in range(1, 4):
        for one in (plain, env, late):
            one.step(UP)
        assert np.array_equal(env.drive.poses, plain.drive.poses)
        now = 0.6 * decision
        slow = 0.25 * int(now / 0.25 + 1e-6)
        assert seen(env.perception) == pytest.approx((now, now, slow, now))
        then = now - 0.12
        slow = 0.25 * int(then / 0.25 + 1e-6)
        assert seen(late.perception) == pytest.approx((then, then, slow, then))
    assert log.at("fast") == pytest.approx(np.arange(181) * 0.01)
    assert log.at("slow") == pytest.approx(np.arange(8) * 0.25)
    assert log.times == pytest.approx(np.arange(181) * 0.01)
    assert np.array_equal(np.concatenate(log.poses)[-1], env.drive.poses[-1])
    terms = ["end", "flipper", "pitch"]
    assert log.order == ["begin", f"0.0 0.00 {terms}", f"0.6 0.60 {terms}", f"1.2 1.20 {terms}"]


@pytest.mark.usefixtures("registry")
def test_instruments_whose_periods_do_not_fit_into_a_decision_keep_them() -> None:
    @api.sensor("odd_clocks")
    class Odd(Clocks):
        def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
            return {"fast": Clock(0.07), "slow": Clock(0.25), "decision": Clock(None)}

    env, log = FlipperEnv("step", perception=Odd()), Log()
    env.observers = (log,)
    env.reset(seed=1)
    for _ in range(3):  # 1.8 s
        env.step(UP)
    assert log.at("fast") == pytest.approx(np.arange(26) * 0.07)
    assert log.at("slow") == pytest.approx(np.arange(8) * 0.25)


def test_an_episode_that_ends_between_two_decisions_is_measured_to_its_end(
    clocks: type[api.Sensor],
) -> None:
    env, log = FlipperEnv("flat", perception=clocks(), episode={"run_out": 0.2}), Log()
    env.observers = (log,)
    env.reset(seed=0)
    while not any(env.step(UP)[2:4]):
        pass
    fast = log.at("fast")
    assert fast == pytest.approx(np.arange(len(fast)) * 0.01)
    assert fast[-1] == pytest.approx(env.state.time) == pytest.approx(env.perception.pitch)
    assert env.state.time % 0.6 > 0.005


@pytest.mark.usefixtures("registry")
@pytest.mark.parametrize("name", ["scanner", "inertial"])
def test_the_simulator_perceives_like_the_episode_and_returns_to_snapshots(name: str) -> None:
    plugins.load([EXAMPLES / "scanner.py", EXAMPLES / "inertial.py"])
    env = FlipperEnv("stair", perception={"name": name, "noise": 0.01, "delay": 0.1})
    env.reset(seed=7)
    simulator = env.simulator()
    perceived = [simulator.perceive()]
    for _ in range(4):
        simulator.step(UP)
        perceived.append(simulator.perceive())
    saved = simulator.save()
    again = [simulator.perceive() for _ in range(2)]
    poses = simulator.poses
    simulator.step(UP)
    simulator.perceive()
    simulator.load(saved)
    assert simulator.poses is poses  # of the last decision before the snapshot
    assert [p.observation.tolist() for p in again] == [
        simulator.perceive().observation.tolist() for _ in range(2)
    ]
    for p in perceived:
        assert np.array_equal(p.observation, env.perception.observation)
        assert np.array_equal(p.points, env.perception.points)
        env.step(UP)


@pytest.mark.usefixtures("registry")
def test_the_examples_estimate_what_is_true() -> None:
    plugins.load([EXAMPLES / "scanner.py", EXAMPLES / "inertial.py"])
    envs = [FlipperEnv("stair", perception=name) for name in ("planar", "scanner", "inertial")]
    biased = FlipperEnv("stair", perception={"name": "inertial", "bias": 0.1})
    for env in (*envs, biased):
        env.reset(seed=3)
        for _ in range(8):
            env.step(UP)
    true, scanned, integrated = (env.perception.observation for env in envs)
    ahead = slice(5, 11)  # from 0.375 m behind the chassis centre to 0.525 m ahead of it
    assert scanned[ahead] == pytest.approx(true[ahead], abs=0.04)
    assert integrated[-3:] == pytest.approx(true[-3:], abs=0.02)
    drift = biased.perception.pitch - envs[2].perception.pitch
    assert 0.005 < abs(drift) <= 0.1 * 4.8  # up to 0.1 rad/s for 4.8 s


@pytest.mark.usefixtures("registry")
def test_a_sensor_that_casts_rays_needs_an_engine_that_can() -> None:
    plugins.load([EXAMPLES / "scanner.py", EXAMPLES / "kinematic.py"])
    env = FlipperEnv("step", sim="kinematic", perception="scanner")
    with pytest.raises(ConfigError, match=r"casts rays, which sim=kinematic cannot; choose"):
        env.reset(seed=0)


def broken(registry: dict, **methods: Any) -> FlipperEnv:
    """Return an environment with a sensor some of whose methods are replaced."""
    made = type("Broken", (Clocks,), {"__doc__": "Broken.", "__module__": __name__, **methods})
    return FlipperEnv("flat", perception=api.sensor("broken")(made)())


@pytest.mark.parametrize(
    ("methods", "text"),
    [
        ({"instruments": lambda s, m: [1]}, r"instruments returned \[1\]; .*a mapping of names"),
        ({"instruments": lambda s, m: {"a": 1}}, r"instruments returned {'a': 1}; .*Instruments"),
        ({"instruments": lambda s, m: {"a": Clock(0.015)}}, "instruments .* whose period is"),
        ({"estimator": lambda s, r: 3}, "estimator returned 3, which has no update"),
    ],
)
def test_a_part_that_is_wrong_is_named(registry: dict, methods: dict, text: str) -> None:
    with pytest.raises(PluginFailedError, match=rf"perception 'broken': {text}.*\(.*:\d+\)"):
        broken(registry, **methods).reset(seed=0)


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"seen": np.ones(3)}, r"seen is an array of float64 and the shape \(3,\) for \(15,\)"),
        ({"heights": np.ones(15)}, r"heights is .* the shape \(15,\) for \(30,\)"),
        ({"position": np.ones(3)}, r"position is .* the shape \(3,\) for \(2,\)"),
        ({"position": np.array([0.0, np.nan])}, "NaN or infinity in position"),
        ({}, "'broken': estimate returned NaN or infinity in angles"),
    ],
)
def test_estimates_are_checked(registry: dict, changed: dict, text: str) -> None:
    class Odd(Ages):
        def estimate(self, time: float) -> tuple[SensedGround, SensedAngles]:
            ground, angles = super().estimate(time)
            return replace(ground, **changed), replace(
                angles, rear=angles.rear if changed else np.nan
            )

    env = broken(registry, estimator=lambda s, robot: Odd())
    with pytest.raises((PluginFailedError, NonFiniteError), match=text):
        env.reset(seed=0)


def test_a_sensor_needs_over_or_both_parts(registry: dict) -> None:
    class Half(api.Sensor):
        def instruments(self, mounting: api.Mounting) -> Mapping[str, api.Instrument]:
            return {}

    with pytest.raises(TypeError, match=r"Half needs a method over\(profile, margin\), or both"):
        api.sensor("half")(Half)


def test_the_simulator_repeats_the_episode_without_changing_it() -> None:
    env, reference = FlipperEnv("stair"), FlipperEnv("stair")
    env.reset(seed=4)
    reference.reset(seed=4)
    simulator = env.simulator()
    actions = [8, 8, 1, 4, 3, 0, 5]
    for action in actions:
        simulator.step(action)
        reference.step(action)
    assert simulator.state.pitch == reference.state.pitch
    assert np.array_equal(simulator.poses, reference.drive.poses)
    assert simulator.profile is env.profile
    assert env.state.time == 0.0
    saved = simulator.save()
    ahead = [simulator.step(4) for _ in range(3)]
    there = simulator.state
    simulator.load(saved)
    assert simulator.state.time == pytest.approx(reference.state.time)
    assert [simulator.step(4) for _ in range(3)] == ahead
    assert simulator.state.position == pytest.approx(there.position, abs=0.02)
    simulator.restart()
    assert simulator.state.time == 0.0


def test_a_policy_perceives_in_the_simulator_what_it_does_in_the_episode() -> None:
    noise = {"perception.noise": 0.01, "perception.dropout": 0.2, "perception.delay": 0.1}
    env = FlipperEnv("stair", **noise)
    env.reset(seed=7)
    simulator = env.simulator()
    for _ in range(2):
        simulator.restart()
        perceived = []
        for _ in range(5):
            p = simulator.perceive()
            perceived.append((p.observation, p.points, len(p.recent), p.rng.random()))
            simulator.step(8)
        env.reset(seed=7)
        for observation, points, recent, number in perceived:
            p = env.perception
            assert np.array_equal(p.observation, observation)
            assert np.array_equal(p.points, points)
            assert (len(p.recent), p.rng.random()) == (recent, number)
            env.step(8)


def test_exact_perception_alone_tells_the_drawn_physics() -> None:
    drawn = {"randomise.sim.friction": [0.6, 0.6], "randomise.robot.flipper_length": [0.5, 0.5]}
    env = FlipperEnv(terrain="step", **drawn)
    env.reset(seed=1)
    simulator = env.simulator()
    exact, perceived = simulator.perceive_exactly(), simulator.perceive()
    assert (exact.friction, exact.robot.flipper_length) == (0.6, 0.5)
    assert (perceived.friction, perceived.robot) == (None, env.config.robot)
    assert env.config.robot.flipper_length != 0.5


def test_a_fresh_generator_draws_and_spawns_the_same_again() -> None:
    (rng,) = np.random.default_rng(1).spawn(1)
    drawn, spawned = rng.random(3), [child.random() for child in rng.spawn(2)]
    for _ in range(2):
        again = initial_copy(rng)
        assert np.array_equal(again.random(3), drawn)
        assert [child.random() for child in again.spawn(2)] == spawned
