"""The planner: its plans are the best known and are carried out in the episode."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flipperctl.api import Outcome, Perception, Policy, Simulator, action_index
from flipperctl.config import EnvConfig, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.lookahead import planner
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import play

pytestmark = pytest.mark.slow

MPC = {"name": "mpc", "value": ""}
QUICK = {"name": "planner", "width": 6, "budget": 6000}


def built(name: object) -> Policy:
    policy: Policy = resolver.create("controller", name, "controller").build()
    return policy


def planned(env: FlipperEnv, **settings: object) -> dict[str, object]:
    return play(env, built({**QUICK, **settings}), seed=1)


def test_a_plan_crosses_a_step_more_smoothly_than_the_policies_it_starts_from() -> None:
    env = FlipperEnv("paper_step", **{"episode.start_noise": 0.0})
    row = planned(env, budget=3000)
    others = [play(env, built(name), seed=1) for name in ("level", "okada", MPC)]
    assert row["outcome"] == Outcome.REACHED
    costs = [r["t_cost"] + 30 * r["pitch_variation_100hz"] for r in (row, *others)]
    assert costs[0] == min(costs)
    assert row["pitch_variation_100hz"] < 0.6 * others[1]["pitch_variation_100hz"]


@pytest.mark.long
def test_the_weight_of_smoothness_trades_time_for_smoothness() -> None:
    env = FlipperEnv("pallet")
    fast, smooth = (planned(env, smoothness=weight) for weight in (0.0, 50.0))
    assert fast["outcome"] == smooth["outcome"] == Outcome.REACHED
    assert fast["t_cost"] < smooth["t_cost"]
    assert smooth["pitch_variation_100hz"] < fast["pitch_variation_100hz"]


def test_a_plan_is_read_from_its_last_action_back_to_the_root() -> None:
    def nodes(parents: list[int], actions: list[int]) -> planner._Nodes:
        some = np.zeros(len(parents))
        return planner._Nodes(*[some] * 6, np.array(parents), np.array(actions))

    expanded = [nodes([-1], [-1]), nodes([0, 0], [5, 7])]  # numbers 0, 1 and 2
    assert planner._trace(expanded, 2, 4) == (7, 4)


@pytest.mark.parametrize(
    ("cost", "variation", "kept"), [(9.0, 1.0, True), (9.0, 1.1, False), (11.0, 0.5, False)]
)
def test_a_cheaper_plan_is_kept_unless_it_is_rougher_than_the_first_ones(
    cost: float, variation: float, kept: bool
) -> None:
    search: Any = SimpleNamespace(_cost=10.0, _roughest=1.0, best=None)
    played: Any = SimpleNamespace(reached=True, cost=cost, variation=variation)
    planner._Search._add(search, "beam", played)
    assert (search.best is played) == kept


class Script:
    """A policy that plays given actions, then holds."""

    def __init__(self, actions: list[int]) -> None:
        self.actions = actions

    def reset(self, simulator: Simulator) -> None:
        self.left = self.actions[::-1]

    def act(self, p: Perception) -> int:
        return self.left.pop() if self.left else action_index(0, 0)


def test_a_given_policy_is_one_of_the_first_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "_STARTS", ("level",))
    env, actions = FlipperEnv("step"), list[int]()
    mpc = resolver.create("controller", MPC, "test").build()
    row = play(env, mpc, seed=1, watch=lambda d: actions.append(d.action))
    settings = {**QUICK, "budget": 1, "policy": "a script"}
    plans = resolver.create("controller", settings, "test").using(
        SimpleNamespace(policy=lambda setting: Script(actions))
    )
    again = play(env, plans.build(), seed=1)
    assert again["search_source"] == "policy"
    assert again["pitch_variation_100hz"] == row["pitch_variation_100hz"]


def test_the_policy_is_found_by_its_name() -> None:
    config = EnvConfig(terrain="flat", perception={"highest": False})
    settings = {**QUICK, "budget": 1, "policy": "mpc_value"}
    row = play(FlipperEnv(config=config), PolicySource(settings=settings).build(config), seed=3)
    assert row["outcome"] == Outcome.REACHED
    with pytest.raises(CheckpointError, match="did you mean 'mpc_value'"):
        PolicySource(settings={**settings, "policy": "mpc_valu"}).build(config)
    with pytest.raises(ConfigError, match="reads no policy"):
        built(settings)
