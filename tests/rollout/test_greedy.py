"""Greedy episodes are equal in the learner's process and in a worker's."""

from pathlib import Path

import pytest
import torch

from flipperctl.agent.frames import input_size
from flipperctl.config import to_dict
from flipperctl.rollout.actor import Actor, GreedyPlayer
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("network", ["at_d3qn", "stacked"])
def test_it_does_not_matter_which_process_plays_a_validation(network: str, tmp_path: Path) -> None:
    config = short_config(network={"name": network}, **{"agent.risk": True})
    run = trainer(config, tmp_path)
    state = torch.random.get_rng_state()
    here, there = GreedyPlayer(config, run.validator._greedy._env), Actor(to_dict(config), [])
    weights = run.agent.policy_arrays()
    here.load(weights)
    rows = [here.play(3), there.evaluate(weights, 3)]
    assert rows[0] == rows[1]
    rows_in = torch.randn(200, 1, input_size(config.network, config.perception.layout))
    ours, theirs = (
        torch.cat([m(row) for row in rows_in]) for m in (here.module, there._greedy.module)
    )
    assert torch.equal(ours, theirs)
    torch.random.set_rng_state(state)


def test_it_draws_no_number_of_the_training(tmp_path: Path) -> None:
    config = short_config()
    env = trainer(config, tmp_path).validator._greedy._env
    before = torch.random.get_rng_state()
    GreedyPlayer(config, env)
    assert torch.equal(torch.random.get_rng_state(), before)
