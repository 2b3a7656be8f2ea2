"""``mpc``: it drives by its hand-set cost or a learned value, repeats itself, and refuses."""

from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from flipperctl import checkpoint
from flipperctl.api import (
    Controller,
    FloatArray,
    LearnedValue,
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
from flipperctl.lookahead import Mpc, mpc
from flipperctl.policies.source import PolicySource, learned_value
from flipperctl.policies.trained import policy_module
from flipperctl.requests.plan import scenes
from flipperctl.requests.text import from_words
from flipperctl.rollout.episode import decisions, play
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

SMALL = {"beam": 3, "horizon": 4}


def built(name: str, **settings: object) -> Policy:
    reference = resolver.reference(name, "controller")
    return resolver.create("controller", {**reference, **settings}, "controller").build()


# The hand-set cost


def test_it_crosses_more_smoothly_than_the_rules() -> None:
    env = FlipperEnv("pallet")
    row, *rules = (
        play(env, built(name, **s), seed=2)
        for name, s in (("mpc", {"beam": 6, "horizon": 7}), ("okada", {}), ("level", {}))
    )
    assert row["outcome"] == Outcome.REACHED
    crossed = [r["pitch_variation_100hz"] for r in rules if r["outcome"] == Outcome.REACHED]
    assert row["pitch_variation_100hz"] < min(crossed)


def test_equal_episodes_are_equal_and_a_policy_forgets_the_last_one() -> None:
    env = FlipperEnv("step", **{"perception.noise": 0.01, "perception.dropout": 0.2})
    policy = built("mpc", beam=3, horizon=4)
    first = play(env, policy, seed=5)
    assert play(env, policy, seed=5) == first


def test_latency_is_simulated_before_the_search() -> None:
    env = FlipperEnv("uplift", **{"robot.actuator_delay": 0.2, "perception.delay": 0.1})
    late, aware = (play(env, built("mpc", latency=s, **SMALL), seed=3) for s in (0.0, 0.3))
    assert late["outcome"] == aware["outcome"] == Outcome.REACHED
    assert late["pitch_variation_decisions"] != aware["pitch_variation_decisions"]


def test_a_time_limit_ends_the_search_and_not_the_drive() -> None:
    policy = built("mpc", time_limit=1e-6)
    for _ in islice(decisions(FlipperEnv("pallet"), policy, 4), 12):
        assert len(policy._plan.actions) == 1


@pytest.mark.long
def test_the_longer_it_stands_the_wider_it_searches() -> None:
    """Perceived with noise, this trench holds it for good without that."""
    ((config, _),) = scenes(from_words(["terrain=gap", "conditions=varied"]), None, "mpc")
    env = FlipperEnv(config=config.environment())
    assert play(env, built("mpc"), seed=2923855607)["outcome"] == Outcome.REACHED


def test_a_robot_at_full_speed_does_not_stand_however_short_its_decisions() -> None:
    env = FlipperEnv("flat", robot={"control_period": 0.12})
    policy = Mpc(value="", **SMALL).build()
    for _ in islice(decisions(env, policy, 0), 8):
        pass
    assert policy._standing == 0


# A learned value


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
    return {
        name: resolver.create("reward", {"name": name, "weight": weight}, "rewards")
        for name, weight in weights.items()
    }


def valued(own: dict[str, RewardTerm], value: Any = none_beyond, **more: Any) -> Any:
    learned = LearnedValue(value, own, 0.99, ObservationLayout())
    return Mpc(value="run", **{**SMALL, **more}).ending_with(learned).build()


def test_it_takes_the_hand_set_plan_where_its_own_is_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default robot drives at 0.2 m/s."""
    env, own = FlipperEnv("step"), terms(end=2.0, swing=4.0)

    def driven(policy: Policy) -> list[int]:
        return [d.action for d in islice(decisions(env, policy, 3), 14)]

    returns = driven(valued(own, low, friction=0.8, hurry_below=0.0))
    hand_set = driven(Mpc(value="", friction=0.8, **SMALL).build())
    assert returns != hand_set
    for share, speed, expected in (
        (0.4, 0.07, hand_set),
        (0.4, 0.09, returns),
        (0, -0.01, returns),
    ):
        monkeypatch.setattr(mpc, "_speed", lambda plan, robot, speed=speed: speed)
        assert driven(valued(own, low, friction=0.8, hurry_below=share)) == expected


def test_it_drives_by_its_rewards_to_the_finish() -> None:
    driven = valued(terms(end=2.0, shaped_progress=10.0, swing=4.0), low)
    row = play(FlipperEnv("step"), driven, seed=3)
    assert row["outcome"] == Outcome.REACHED
    assert play(FlipperEnv("step"), driven, seed=3) == row  # it forgets the last episode


def test_a_robot_that_rocks_in_place_stands_and_assumes_less_friction() -> None:
    rocking = valued(terms(end=1.0))
    rocking.reset(FlipperEnv("flat").simulator)
    moves = [(0.1, 0.0), (0.0, 0.0), (0.05, 0.02), (-0.05, -0.02), (0.05, 0.02), (0.02, 0.0)]
    assert [rocking._stood(m) for m in moves] == [False, True, False, True, True, True]
    assert not rocking._stood((0.02, 0.0))  # 0.04 m farther than ever
    assumed = []
    for rocking._standing in (0, 2, 3, 6):
        assumed.append(rocking._assumed_friction())
    assert assumed == pytest.approx([1.0, 1.0, 0.8, 0.64])


def test_rewards_of_the_settings_replace_those_of_the_value() -> None:
    """Paid for travel alone, the flippers stay as they are; else they rise, as the value wants."""

    def front(observations: NDArray[np.float32]) -> FloatArray:
        return 10.0 * observations[:, -3].astype(np.float64)

    env = FlipperEnv("step")
    raised, still = (
        play(env, valued(terms(end=1.0), front, **more), seed=1)["flipper_travel"]
        for more in ({}, {"rewards": {"travel": {"name": "travel", "weight": 100.0}}})
    )
    assert still == pytest.approx(0.0, abs=0.01)
    assert raised > 0.5


def test_without_a_price_on_travel_flippers_hold_still_on_level_ground() -> None:
    """Every plan ends at once, and all are paid alike."""
    played = play(FlipperEnv("flat"), valued(terms(end=1.0)), seed=1)
    assert played["flipper_travel"] == pytest.approx(0.0, abs=0.01)


def test_rewards_need_values_of_what_follows_and_predictions() -> None:
    for settings, text in (
        ({"rewards": {"end": "end"}}, r"controller\.rewards: .* set controller\.value to a run"),
        ({"value": "run"}, r"controller\.value=run: the file of the values was not read"),
    ):
        with pytest.raises(ConfigError, match=text):
            Mpc(**settings).build()
    with pytest.raises(ConfigError, match="'unpredictable' needs: the motors' currents"):
        valued({"odd": Unpredictable()})


def test_the_shaping_that_cancels_is_that_of_the_value() -> None:
    """Each state's value lacks the potential of its own training's shaping."""
    own, given = terms(swing=8.0, shaped_progress=10.0), terms(pitch=1.0, shaped_progress=3.0)
    made = valued(own, rewards=given)
    assert made._rewards.terms == {
        "pitch": given["pitch"],
        "value.shaped_progress": own["shaped_progress"],
    }
    assert list(valued(terms(swing=8.0), rewards=given)._rewards.terms) == ["pitch"]


# Values of runs


def saved_run(folder: Path, **settings: object) -> str:
    """Return the run of an untrained policy."""
    trainer(short_config(**settings), folder).save()
    return str(folder)


def test_the_value_of_a_run_is_that_of_its_best_action_in_the_rewards_unit(tmp_path: Path) -> None:
    run = saved_run(tmp_path, **{"agent.reward_scale": 0.25, "agent.gamma": 0.9})
    found = learned_value(run, "controller.value")
    observations = np.random.default_rng(0).normal(size=(5, found.layout.size)).astype(np.float32)
    last = checkpoint.read(tmp_path / checkpoint.LAST)
    import torch

    with torch.no_grad():
        best = policy_module(last)(torch.from_numpy(observations)).max(dim=1).values
    assert found.value(observations) == pytest.approx(4 * best.numpy())
    assert found.value(observations).dtype == np.float64
    assert (found.gamma, set(found.rewards)) == (0.9, set(short_config().rewards))
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
    with pytest.raises(CheckpointError, match="nowhere"):
        learned_value("nowhere", "controller.value")


def test_searched_values_without_temporal_difference_are_accepted(tmp_path: Path) -> None:
    teacher = {"teacher.controller": {"name": "value_iteration"}, "teacher.loss": "values"}
    run = saved_run(tmp_path, **teacher, **{"teacher.td_weight": 0.0})
    assert learned_value(run, "controller.value").gamma == 0.99
