"""The developers' measures at their smallest, and the tables that they make."""

import json
import math
import shlex
from importlib import import_module
from unittest.mock import patch

import numpy as np
import pytest

from benchmarks import (
    coverage,
    engine_agreement,
    learner,
    lidar,
    map_errors,
    results,
    seed_coverage,
    statics,
    tables,
)
from benchmarks.settings import MEASURES, Benchmark, quantity, ratio, sizes, table
from flipperctl.api import Robot
from flipperctl.config import EnvConfig, EvalConfig, TrainConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.learners.double_q import DoubleQ
from flipperctl.policies.source import load_policy
from flipperctl.sim.planar.sensing import correlated

UNITS = {"m", "rad", "1/s", "s", "ms", "µs", "MiB", "-"}


def small_benchmark(**changes: object) -> Benchmark:
    """Return small sizes on steps, whose runs end by their budget and not by the clock."""
    config = TrainConfig(
        terrain="step", network="at_d3qn", seed=3, train={"decisions": 250, "workers": 2}
    )
    return Benchmark(config, sizes(small=True, changes={"limit": 3600.0, **changes}))


def check(found: dict) -> None:
    """Check raw numbers and units, and that the statistics follow from the raw numbers."""
    assert found["about"]
    for name, q in found["quantities"].items():
        assert q["unit"] in UNITS, name
        ordered = sorted(math.inf if v is None else v for v in q["values"])
        middle = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
        assert q["median"] == (pytest.approx(middle) if math.isfinite(middle) else None), name
        if q["low"] is not None:
            assert ordered[0] <= q["low"] <= (q["median"] or math.inf), name


OKADA = load_policy("okada", "--controller")
RATIOS = {
    "engines": "mujoco.flat / planar.flat",
    "physics": "environment_decisions / bare_decisions",
    "accuracy": "paper_step.100hz.5ms / paper_step.100hz.1.25ms",
    "lookahead": "simulated_decisions / environment_decisions",
    "lidar": "lidar.true / true_ground",
    "updates": "flipperctl / sb3_fused, updates of 32",
    "solve": "sb3 / flipperctl, decisions",
    "startup": "flipperctl --help / python -c pass",
}
"""One of the ratios of each measure, which the documentation explains."""


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in MEASURES if name != "physics"])
def test_a_measure_runs(name, monkeypatch) -> None:
    few = {"name": "lidar", "azimuths": 8, "scan_parts": 1}
    monkeypatch.setattr(lidar, "CONTESTANTS", {lidar.TRUE: {"name": "planar"}, "lidar.true": few})
    found = import_module(f"benchmarks.{name}").measure(small_benchmark())
    check(found)
    assert found.get("missing", []) == []
    assert name not in RATIOS or found["ratios"][RATIOS[name]]


@pytest.mark.parametrize("priority", [0, 0.6])
def test_the_learner_s_updates_are_the_gradient_steps_that_it_takes(priority: float) -> None:
    agent = {"priority": priority, "updates_together": 3, "privileged_value": True}
    config = TrainConfig(terrain="flat", network="at_d3qn", agent=agent)
    contestant = learner.contestant(config, learner.fill(config, 20, 0), 8, 0)
    with patch.object(DoubleQ, "_descend", autospec=True, side_effect=DoubleQ._descend) as steps:
        contestant.update()
    assert contestant.together == steps.call_count == 3
    assert steps.call_args.args[0].baselines is not None


def test_no_page_disagrees_with_its_results() -> None:
    stale = [str(page) for page, _ in tables.changes()]
    assert stale == [], "run python -m benchmarks.tables"
    every = [f for f in tables.FOLDER.glob("*.json") if not f.name.startswith(tables.SHIPPED)]
    assert {file.stem for file in every} == set(results.COMMANDS)
    for file in every:
        document = json.loads(file.read_text())
        assert document["command"] == results.COMMANDS[file.stem]
        words = shlex.split(document["command"])
        episodes = int(words[words.index("--episodes") + 1])
        assert {row["episodes"] for row in document["rows"]} == {episodes}


@pytest.mark.parametrize(
    "terrain",
    ["step", *(pytest.param(t, marks=pytest.mark.long) for t in ("stair", "ramp", "rubble"))],
)
def test_both_engines_agree_on_the_same_actions(terrain) -> None:
    config = EvalConfig(terrain=terrain, sim="mujoco", eval={"episodes": 2, "seed": 13})
    pairs = engine_agreement.compare_engines(config, OKADA)
    assert [pair.agrees and pair.both_reached and pair.pitch_rms < 0.05 for pair in pairs] == [
        True
    ] * 2


@pytest.mark.parametrize("engine", ["planar", "mujoco"])
def test_a_wall_lifts_level_flippers_from_the_friction_of_statics_on(engine) -> None:
    # The belts slip at the wall and at the rear end, whose forces are μ² N and μ N: moments about
    # the rear end, 0.616 m behind the centre of mass and 1.332 m behind the wall, 0.1 m below the
    # nose, give 1.332 μ² + 0.1 μ = 0.616 (1 + μ²).
    lifts = (-0.1 + math.sqrt(0.1**2 + 4 * (1.332 - 0.616) * 0.616)) / (2 * (1.332 - 0.616))
    for friction, expected in ((lifts - 0.06, False), (lifts + 0.06, True)):
        settings = {"name": engine, "friction": friction}
        wall = {"name": "step", "height": 0.4}
        env = FlipperEnv(config=EnvConfig(terrain=wall, sim=settings))
        policy = load_policy("level", "").build(env.config)
        _, poses, _ = engine_agreement.play(env, policy, 0)
        assert (poses[:, 2].max() > 0.1) == expected, friction


def test_the_static_bound_of_an_incline() -> None:
    def bound(degrees: float, robot: Robot) -> float:
        end = 3.0 * math.cos(math.radians(degrees)), 3.0 * math.sin(math.radians(degrees))
        points = np.array([[0.0, 0.0], end])
        return math.degrees(statics.static_bound(points, robot, start=-1.0, finish=end[0] + 1.0))

    # Without flippers it is twice the angle, less 11° of tolerances. Flippers carry the chassis by
    # 21.8°, thus 8.2° are left of 30°; the finish allows 10.3° (0.1 m of 0.56 m).
    assert 49.0 <= bound(30, Robot(angle_limit=0.01, angle_step=0.01)) <= 60.0
    assert 4.0 <= bound(30, Robot()) <= 8.2
    assert bound(20, Robot()) == 0.0


def test_intervals_contain_the_truth_as_often_as_stated() -> None:
    rng = np.random.default_rng(7)
    found = coverage.mean_coverage(2.0, lambda r, size: r.normal(2.0, 3.0, size), 10, 1000, rng)
    assert found == pytest.approx(0.95, abs=0.02)
    # Of 5, the intervals of 1 to 4 contain 0.5, those of 0 and 5 do not: 1 − 2 / 32.
    assert coverage.rate_coverage(0.5, 5) == pytest.approx(30 / 32)
    assert 0.93 <= coverage.paired_coverage(0.3, 0.3, 20) <= 1.0
    seeds = seed_coverage.coverage((0.5, 0.1, 0.1), seed_coverage.SHAPES["normal"], 3, 60, 0)
    assert seeds["mean"] > 0.9 > seeds["mean, percentile bootstrap"]


def test_the_errors_of_a_map_on_level_ground_are_found_again() -> None:
    x = np.arange(600 * 15 * 10) * 0.15 / 10
    values = 0.006 * correlated(x, 0.25, np.random.default_rng(4))
    errors = values.reshape(600, 15, 10).mean(axis=2)
    found = map_errors.fit([map_errors.Errors(errors, np.zeros_like(errors), 0.15)])
    assert (found.height, found.length) == pytest.approx((0.006, 0.25), rel=0.2)


def test_a_quantity_keeps_its_raw_numbers_and_has_quartiles_between_neighbours() -> None:
    found = quantity([4.0, 1.0, 3.0, 2.0, 5.0], "1/s")
    assert (found["low"], found["median"], found["high"]) == (2.0, 3.0, 4.0)
    assert (found["values"], found["unit"]) == ([4.0, 1.0, 3.0, 2.0, 5.0], "1/s")
    found = quantity([1.0, 2.0], "s")
    assert (found["low"], found["median"], found["high"]) == (1.25, 1.5, 1.75)


def test_a_ratio_is_of_medians_and_its_spread_of_pairs() -> None:
    found = ratio([2.0, 9.0, 4.0], [1.0, 3.0, 4.0])  # pairs 2, 3, 1; medians 4 and 3
    assert found["ratio"] == pytest.approx(4 / 3)
    assert (found["low"], found["high"], found["rounds"]) == (1.5, 2.5, 3)


def test_an_unsolved_run_is_told_as_such() -> None:
    unsolved = {"unit": "s", "median": None, "low": None, "high": None, "values": [None]}
    found = {"about": "a", "quantities": {"sb3": unsolved}, "unfinished": "not within 600 s"}
    assert table("solve", found).texts() == [["sb3", "not within 600 s", "–", "s"]]
