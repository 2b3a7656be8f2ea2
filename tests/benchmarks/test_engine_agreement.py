"""Both engines agree on the same actions: a subset of ``python -m benchmarks.engine_agreement``."""

import math

import numpy as np
import pytest

from benchmarks.engine_agreement import _episode as episode
from benchmarks.engine_agreement import _play as drive
from benchmarks.engine_agreement import compare_engines, in_default_engine
from flipperctl.api import Outcome
from flipperctl.config import EnvConfig, EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.policies.source import PolicySource

OKADA = PolicySource.of_plugin("okada", "--controller")


def config(terrain: str, **sim: float) -> EvalConfig:
    settings = {"name": "mujoco", **sim}
    return EvalConfig(terrain=terrain, sim=settings, eval={"episodes": 2, "seed": 13})


@pytest.mark.parametrize(
    "terrain",
    ["step", "stair", "building_stair", "ramp", "rubble", "wave", "uplift", "paper_step"],
)
def test_both_engines_agree_on_the_same_actions(terrain: str) -> None:
    found = compare_engines(config(terrain), OKADA)
    assert all(e.agrees and e.both_reached and e.pitch_rms < 0.05 for e in found)
    assert len(found) == 2


def test_friction_and_gravity_are_shared_and_the_rest_is_not() -> None:
    plane = in_default_engine(config("step", friction=0.5, gravity=3.7, substep=0.0025))
    assert plane.sim.plugin_name == "planar"
    assert (plane.sim.friction, plane.sim.gravity, plane.sim.substep) == (0.5, 3.7, 0.005)
    with pytest.raises(ConfigError, match="sim=planar is the engine to compare with"):
        in_default_engine(plane)


def test_pitches_are_compared_while_both_drive() -> None:
    row = {"terrain": "", "seed": 1, "outcome": "reached", "pitch_variation_100hz": 1.0}
    ours, theirs = np.zeros((100, 5)), np.zeros((120, 5))
    ours[:, 0] = np.arange(100) / 10
    theirs[50:, 2] = 0.06  # for half of the common second
    found = episode(0, ({**row, "t_cost": 1.0}, {**row, "t_cost": 1.2}), (ours, theirs))
    assert found.pitch_rms == pytest.approx(0.06 / math.sqrt(2))
    assert found.parts_at == (0.51, 5.0)
    assert found.pitch_rms_along == 0.0  # the second stands still
    assert found.time_ratio == pytest.approx(0.2)
    assert not found.agrees  # 20 % slower
    late = np.concatenate([np.zeros((20, 5)), ours])
    late[20:, 2] = ours[:, 2] = np.sin(ours[:, 0])
    delayed = episode(0, ({**row, "t_cost": 1.0}, {**row, "t_cost": 1.2}), (ours, late))
    assert delayed.pitch_rms > 0.1
    assert delayed.pitch_rms_along == pytest.approx(0.0, abs=1e-12)
    ours[:, 2] = 0.0
    stuck = {**row, "outcome": "stuck", "t_cost": 1.2}
    other = episode(0, ({**row, "t_cost": 1.0}, stuck), (ours, theirs))
    assert (other.outcomes, other.agrees) == ((Outcome.REACHED, Outcome.STUCK), False)
    alike = episode(0, (stuck, stuck), (ours, theirs))
    assert alike.agrees  # where neither reaches the finish, the outcome counts


@pytest.mark.parametrize("engine", ["planar", "mujoco"])
def test_a_wall_lifts_level_flippers_from_the_friction_of_statics_on(engine: str) -> None:
    # The belts slip at the wall and at the rear end, whose forces are μ² N and μ N: moments about
    # the rear end, 0.616 m behind the centre of mass and 1.332 m behind the wall, 0.1 m below the
    # nose, give 1.332 μ² + 0.1 μ = 0.616 (1 + μ²).
    lifts = (-0.1 + math.sqrt(0.1**2 + 4 * (1.332 - 0.616) * 0.616)) / (2 * (1.332 - 0.616))
    assert lifts == pytest.approx(0.86, abs=0.002)
    for friction, expected in ((lifts - 0.06, False), (lifts + 0.06, True)):
        settings = {"name": engine, "friction": friction}
        wall = {"name": "step", "low": 0.4, "high": 0.4}
        env = FlipperEnv(config=EnvConfig(terrain=wall, sim=settings))
        _, poses, _ = drive(env, PolicySource.of_plugin("level", "").build(env.config), 0)
        assert (poses[:, 2].max() > 0.1) == expected, friction


def test_what_only_the_other_engine_samples_is_named() -> None:
    sampled = {"friction": [0.6, 1.2], "sim": {"lateral_slope": [0, 0.1], "one_sided": [0, 1]}}
    config = EvalConfig(terrain="step", sim="mujoco", randomise=sampled)
    keys = r"randomise\.sim\.lateral_slope, randomise\.sim\.one_sided: sim=planar"
    with pytest.raises(ConfigError, match=rf"^{keys}.*add randomise\.sim\.lateral_slope=null ran"):
        in_default_engine(config)
