"""``mpc`` with its hand-set cost: it drives more smoothly than the rules, and repeats itself."""

import json
from itertools import islice
from pathlib import Path

import pytest

from flipperctl.api import Controller, Outcome
from flipperctl.cli.scenes import scenes
from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.lookahead.controllers import Mpc
from flipperctl.lookahead.mpc_policy import MpcPolicy
from flipperctl.rollout.episode import decisions, play
from tests.cli.call import call

pytestmark = pytest.mark.slow

MPC: dict[str, object] = {"name": "mpc", "value": ""}


def played(env: FlipperEnv, name: str, seed: int, **settings: object) -> dict[str, object]:
    reference = resolver.reference(name, "controller")
    found = resolver.create("controller", {**reference, **settings}, "controller")
    assert isinstance(found, Controller)
    return play(env, found.build(), seed=seed)


@pytest.mark.parametrize("terrain", ["paper_stair", "pallet"])
def test_it_crosses_more_smoothly_than_the_rules(terrain: str) -> None:
    env = FlipperEnv(terrain)
    row = played(env, "mpc", 2)
    rules = [played(env, name, 2) for name in ("okada", "level")]
    assert row["outcome"] == Outcome.REACHED
    crossed = [r["pitch_variation_100hz"] for r in rules if r["outcome"] == Outcome.REACHED]
    assert crossed
    assert row["pitch_variation_100hz"] < min(crossed)


def test_equal_episodes_are_equal_and_a_policy_forgets_the_last_one() -> None:
    env = FlipperEnv("rubble", **{"perception.noise": 0.01, "perception.dropout": 0.2})
    found = resolver.create("controller", MPC | {"beam": 4, "horizon": 5}, "controller")
    assert isinstance(found, Controller)
    policy = found.build()
    first = play(env, policy, seed=5)
    assert first["outcome"] == Outcome.REACHED
    assert play(env, policy, seed=5) == first


def test_it_needs_no_perceived_ground() -> None:
    env = FlipperEnv("flat", **{"perception.dropout": 0.99})
    assert played(env, "mpc", 1)["outcome"] == Outcome.REACHED


def test_latency_is_simulated_before_the_search() -> None:
    env = FlipperEnv("uplift", **{"robot.actuator_delay": 0.2, "perception.delay": 0.1})
    late, aware = (played(env, "mpc", 3, latency=seconds) for seconds in (0.0, 0.3))
    assert late["outcome"] == aware["outcome"] == Outcome.REACHED
    assert late["pitch_variation"] != aware["pitch_variation"]


def test_a_time_limit_ends_the_search_and_not_the_drive() -> None:
    env = FlipperEnv("pallet")
    found = resolver.create("controller", MPC | {"time_limit": 1e-6}, "controller")
    assert isinstance(found, Controller)
    policy = found.build()
    for _ in islice(decisions(env, policy, 4), 12):
        assert isinstance(policy, MpcPolicy)
        assert policy._plan is not None
        assert len(policy._plan.actions) == 1


def test_the_rules_stand_beside_it_unless_others_are_named(tmp_path: Path) -> None:
    quick = [
        "terrain=flat",
        "--episodes",
        "1",
        "--json",
        "controller.beam=1",
        "controller.horizon=1",
    ]
    scene = json.loads(call("eval", "--controller", "mpc", *quick, cwd=tmp_path).out)["scenes"][0]
    assert [b["controller"] for b in scene["baselines"]] == ["okada", "level"]
    options = ["--controller", "mpc", *quick, "--baseline", "none"]
    assert "baseline" not in json.loads(call("eval", *options, cwd=tmp_path).out)["scenes"][0]


def test_the_longer_it_stands_the_wider_it_searches() -> None:
    """Perceived with noise, this trench holds it for good without that."""
    ((config, _),) = scenes(["terrain=gap", "conditions=varied"], None, "mpc")
    env = FlipperEnv(config=config.environment())
    assert played(env, "mpc", 2923855607)["outcome"] == Outcome.REACHED


def test_a_robot_at_full_speed_does_not_stand_however_short_its_decisions() -> None:
    env = FlipperEnv("flat", robot={"control_period": 0.12})
    env.reset(seed=0)
    policy = Mpc(value="").build()
    policy.reset(env.simulator())
    for _ in range(8):
        env.step(policy.act(env.perception))
    assert policy._standing == 0
