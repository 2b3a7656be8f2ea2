"""The simulator that policies look ahead with."""

import numpy as np
import pytest

from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.perceiving import initial_copy


def test_progress_is_reported() -> None:
    env = FlipperEnv("flat")
    env.reset(seed=0)
    reported: list[float] = []
    simulator = env.simulator(reported.append)
    simulator.report_progress(0.25)
    assert reported == [0.25]


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
    drawn = {"randomise.friction": [0.6, 0.6], "randomise.flipper_length": [0.5, 0.5]}
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
