"""The planner: its plans are smooth, repeatable and carried out in the episode."""

import pytest

from flipperctl.api import Outcome, Policy
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.rollout.episode import play

QUICK = {"name": "planner", "width": 6, "budget": 6000}


def planner(settings: dict[str, object]) -> Policy:
    return resolver.create("controller", {**QUICK, **settings}, "controller").build()


def planned(env: FlipperEnv, **settings: object) -> dict[str, object]:
    return play(env, planner(settings), seed=1)


def test_a_plan_crosses_a_step_more_smoothly_than_the_rule() -> None:
    env = FlipperEnv("paper_step", **{"episode.start_noise": 0.0})
    row = planned(env)
    rule = play(env, resolver.create("controller", "okada", "controller").build(), seed=1)
    assert row["outcome"] == rule["outcome"] == Outcome.REACHED
    assert row["pitch_variation"] < 0.7 * rule["pitch_variation"]
    assert planned(env) == row  # the search is deterministic


def test_the_weight_of_smoothness_trades_time_for_smoothness() -> None:
    env = FlipperEnv("step", **{"terrain.low": 0.25, "terrain.high": 0.25})
    fast, smooth = (planned(env, smoothness=weight) for weight in (0.0, 20.0))
    assert fast["outcome"] == smooth["outcome"] == Outcome.REACHED
    assert fast["t_cost"] < smooth["t_cost"]
    assert smooth["pitch_variation"] < 0.5 * fast["pitch_variation"]


def test_the_budget_bounds_the_search_and_progress_is_reported() -> None:
    env = FlipperEnv("paper_stair")
    env.reset(seed=0)
    fractions: list[float] = []
    planner({"budget": 300}).reset(env.simulator(fractions.append))
    assert 0 < len(fractions) < 20
    assert fractions == sorted(fractions)
    assert fractions[-1] <= 1


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
