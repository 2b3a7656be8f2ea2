"""The environment against Chipmunk alone."""

import pytest

from benchmarks import physics
from flipperctl.env.flipper_env import FlipperEnv
from tests.benchmarks.small import small_benchmark


def test_rates_by_hand() -> None:
    spent = {
        **{"reset": 1.0, "decision": 8.0, "bare": 2.0},
        **{"world": 5.0, "sensing": 1.0, "rewards": 0.5},
    }
    found = physics.Work(decisions=100, substeps=12_000).rates([spent])
    medians = {name: q["median"] for name, q in found["quantities"].items()}
    assert medians["bare_substeps"] == 6000
    assert medians["bare_decisions"] == 50
    assert medians["environment_decisions"] == 12.5
    assert medians["environment_decisions_with_reset"] == pytest.approx(100 / 9)
    assert medians["decision.contacts"] == pytest.approx(30_000)
    assert medians["decision.rest"] == pytest.approx(15_000)
    assert found["ratios"]["environment_decisions / bare_decisions"]["ratio"] == 0.25


def test_both_sides_do_the_same_work() -> None:
    bench = small_benchmark()
    config = bench.config.environment()
    recorded = physics.record(config, "okada", 5)
    env = FlipperEnv(config=config)
    env.reset(seed=5)
    for action, t in zip(recorded.actions, recorded.transitions, strict=True):
        env.step(action)
        assert env.state.pitch == t.after.pitch
    clocks = physics.Clocks(config)
    clocks.bare(recorded)
    assert len(clocks.bare_contacts) == len(recorded.actions)
    assert sum(clocks.bare_contacts) == pytest.approx(sum(recorded.contacts), rel=0.25)
    world = clocks._world(recorded)
    for index, target in enumerate(recorded.targets):
        physics.run(world, target, recorded.samples(index))
    assert world.pitch == env.state.pitch
