"""``mpc`` with a value: it drives by the rewards, and refuses what cannot be."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from flipperctl import checkpoint
from flipperctl.api import (
    Controller,
    FloatArray,
    ObservationLayout,
    Outcome,
    Perception,
    Policy,
    RewardTerm,
    Transition,
    controller,
)
from flipperctl.config import EnvConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.lookahead import mpc_policy as return_policy
from flipperctl.lookahead.controllers import Mpc
from flipperctl.lookahead.mpc_policy import ReturnPolicy
from flipperctl.lookahead.settings import LearnedValue, Value
from flipperctl.policies.source import PolicySource
from flipperctl.policies.trained import policy_module
from flipperctl.policies.values import learned_value
from flipperctl.rollout.episode import play
from tests.short import short_config, trainer

SMALL = {"beam": 3, "horizon": 4}


class Unpredictable(RewardTerm):
    """A term that needs what predictions lack."""

    plugin_name: ClassVar[str] = "unpredictable"
    not_predicted: ClassVar[str] = "the motors' currents"

    def __call__(self, t: Transition) -> float:
        return 0.0


def none_beyond(observations: NDArray[np.float32]) -> FloatArray:
    """Return 0: all that counts is earned before the horizon."""
    return np.zeros(len(observations))


def low(observations: NDArray[np.float32]) -> FloatArray:
    """Return less, the higher the chassis centre lies above the ground below it [m]."""
    return 20.0 * np.minimum(0.0, observations[:, 7].astype(np.float64) + 0.15)


def terms(**weights: float) -> dict[str, RewardTerm]:
    found = {}
    for name, weight in weights.items():
        found[name] = resolver.create("reward", {"name": name, "weight": weight}, "rewards")
        assert isinstance(found[name], RewardTerm)
    return found


def learned(rewards: dict[str, RewardTerm], value: Value = none_beyond) -> LearnedValue:
    return LearnedValue(value, rewards, 0.99, ObservationLayout())


def policy(own: dict[str, RewardTerm], value: Value = none_beyond, **more: Any) -> Policy:
    return Mpc(value="run", **{**SMALL, **more}).ending_with(learned(own, value)).build()


def saved_run(folder: Path, **settings: object) -> str:
    """Return the run of an untrained policy."""
    trainer(short_config(**settings), folder).save()
    return str(folder)


@pytest.mark.parametrize(
    ("share", "speed", "hurries"),
    [(0.4, 0.07, True), (0.4, 0.09, False), (0.0, -0.01, False)],
    ids=["slow", "fast", "never"],
)
def test_it_takes_the_hand_set_plan_where_its_own_is_slow(
    share: float, speed: float, hurries: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default robot drives at 0.2 m/s."""
    env, own = FlipperEnv("step"), terms(end=2.0, swing=4.0)
    returns, hand_set = (
        play(env, driven, seed=3)["pitch_variation_100hz"]
        for driven in (policy(own, low, friction=0.8), Mpc(value="", friction=0.8, **SMALL).build())
    )
    assert returns != hand_set
    monkeypatch.setattr(return_policy, "_speed", lambda plan, robot: speed)
    row = play(env, policy(own, low, friction=0.8, hurry_below=share), seed=3)
    assert row["pitch_variation_100hz"] == (hand_set if hurries else returns)


@pytest.mark.parametrize("terrain", ["flat", "step"])
def test_it_drives_by_its_rewards_to_the_finish(terrain: str) -> None:
    driven = policy(terms(end=2.0, shaped_progress=10.0, swing=4.0), low)
    row = play(FlipperEnv(terrain), driven, seed=3)
    assert row["outcome"] == Outcome.REACHED
    assert play(FlipperEnv(terrain), driven, seed=3) == row  # it forgets the last episode


def test_a_robot_that_rocks_in_place_stands() -> None:
    rocking = policy(terms(end=1.0))
    assert isinstance(rocking, ReturnPolicy)
    rocking.reset(FlipperEnv("flat").simulator)
    moves = [(0.1, 0.0), (0.0, 0.0), (0.05, 0.02), (-0.05, -0.02), (0.05, 0.02), (0.02, 0.0)]
    assert [rocking._stood(m) for m in moves] == [False, True, False, True, True, True]
    assert not rocking._stood((0.02, 0.0))  # 0.04 m farther than ever


def test_a_robot_that_stands_where_its_plan_drove_assumes_less_friction() -> None:
    standing = policy(terms(end=1.0))
    assert isinstance(standing, ReturnPolicy)
    standing.reset(FlipperEnv("flat").simulator)
    assumed = []
    for decisions in (0, 2, 3, 6):
        standing._standing = decisions
        assumed.append(standing._assumed_friction())
    assert assumed == pytest.approx([1.0, 1.0, 0.8, 0.64])


def test_rewards_of_the_settings_replace_those_of_the_value() -> None:
    """Paid for travel alone, the flippers stay as they are; else they rise, as the value wants."""

    def front(observations: NDArray[np.float32]) -> FloatArray:
        return 10.0 * observations[:, -3].astype(np.float64)

    env = FlipperEnv("step")
    raised, still = (
        play(env, policy(terms(end=1.0), front, **more), seed=1)["flipper_travel"]
        for more in ({}, {"rewards": {"travel": {"name": "travel", "weight": 100.0}}})
    )
    assert still == pytest.approx(0.0, abs=0.01)
    assert raised > 0.5


def test_without_a_price_on_travel_flippers_hold_still_on_level_ground() -> None:
    """Every plan ends at once, and all are paid alike."""
    played = play(FlipperEnv("flat"), policy(terms(end=1.0), lambda o: np.zeros(len(o))), seed=1)
    assert played["flipper_travel"] == pytest.approx(0.0, abs=0.01)


def test_rewards_need_values_of_what_follows() -> None:
    with pytest.raises(
        ConfigError, match=r"controller\.rewards: .* set controller\.value to a run"
    ):
        Mpc(rewards={"end": "end"}).build()
    with pytest.raises(
        ConfigError, match=r"controller\.value=run: the file of the values was not read"
    ):
        Mpc(value="run").build()


def test_a_term_that_predictions_lack_is_refused() -> None:
    with pytest.raises(ConfigError, match="'unpredictable' needs: the motors' currents"):
        policy({"odd": Unpredictable()})


# Values of runs


def test_the_value_of_a_run_is_that_of_its_best_action_in_the_rewards_unit(tmp_path: Path) -> None:
    run = saved_run(tmp_path, **{"agent.reward_scale": 0.25, "agent.gamma": 0.9})
    found = learned_value(run, "controller.value")
    observations = np.random.default_rng(0).normal(size=(5, 18)).astype(np.float32)
    last = checkpoint.read(tmp_path / checkpoint.LAST)
    import torch

    with torch.no_grad():
        best = policy_module(last)(torch.from_numpy(observations)).max(dim=1).values
    assert found.value(observations) == pytest.approx(4 * best.numpy())
    assert found.value(observations).dtype == np.float64
    assert (found.gamma, set(found.rewards)) == (0.9, set(short_config().rewards))


def test_a_controller_s_value_is_read_from_its_run(tmp_path: Path) -> None:
    run = saved_run(tmp_path)
    source = PolicySource(settings={"name": "mpc", "value": run, **SMALL})
    row = play(FlipperEnv("flat"), source.build(EnvConfig(terrain="flat")), seed=1)
    assert row["decisions"] > 10


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"network": "stacked"}, r"its network stacked takes \d+ observations, of which a plan"),
        (
            {"teacher.controller": {"name": "okada"}, "teacher.td_weight": 0.0},
            "it only imitated its teacher, so that its values estimate no return",
        ),
    ],
)
def test_runs_whose_values_estimate_no_return_of_one_observation_are_refused(
    settings: dict[str, object], text: str, tmp_path: Path
) -> None:
    run = saved_run(tmp_path, **settings)
    with pytest.raises(CheckpointError, match=rf"^controller\.value={run}: {text}"):
        learned_value(run, "controller.value")


def test_a_teacher_whose_plugin_is_missing_still_taught(
    tmp_path: Path, registry: dict[tuple[str, str], type]
) -> None:
    @controller("mine")
    class Mine(Controller):
        """Do nothing."""

        def act(self, p: Perception) -> int:
            return 4

    run = saved_run(tmp_path, **{"teacher.controller": {"name": "mine"}, "teacher.td_weight": 0.0})
    del registry["controller", "mine"]
    with pytest.raises(CheckpointError, match=r"it only imitated its teacher"):
        learned_value(run, "controller.value")


def test_searched_values_without_temporal_difference_are_accepted(tmp_path: Path) -> None:
    teacher = {"teacher.controller": {"name": "value_iteration"}, "teacher.loss": "values"}
    run = saved_run(tmp_path, **teacher, **{"teacher.td_weight": 0.0})
    assert learned_value(run, "controller.value").gamma == 0.99


def test_a_run_that_does_not_exist_is_named() -> None:
    with pytest.raises(CheckpointError, match="nowhere"):
        learned_value("nowhere", "controller.value")


def test_the_shaping_that_cancels_is_that_of_the_value() -> None:
    """Each state's value lacks the potential of its own training's shaping."""
    own, given = terms(swing=8.0, shaped_progress=10.0), terms(pitch=1.0, shaped_progress=3.0)
    made = ReturnPolicy(Mpc(value="run", rewards=given), learned(own))
    assert made._rewards.terms == {
        "pitch": given["pitch"],
        "value.shaped_progress": own["shaped_progress"],
    }
    plain = ReturnPolicy(Mpc(value="run", rewards=given), learned(terms(swing=8.0)))
    assert list(plain._rewards.terms) == ["pitch"]
