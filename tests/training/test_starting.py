"""A training that starts with the weights of another one."""

from pathlib import Path
from typing import Any

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.learner import Learner
from flipperctl.agent.policy_gradient import PolicyGradient
from flipperctl.config import to_dict
from flipperctl.errors import CheckpointError, ConfigError, RequestError
from flipperctl.training import run as preflight
from tests.short import short_config, trainer

VALUES = "agent.policy_gradient.start_values"


def test_the_networks_start_with_the_weights_of_the_run(short_run: Path, tmp_path: Path) -> None:
    new = trainer(
        short_config(**{"agent.start_from": str(short_run), "train.decisions": 1}), tmp_path
    )
    new.run()
    theirs = checkpoint.read(checkpoint.find(short_run)).part("policy")
    for network in (new.agent.online, new.agent.target):
        assert all(torch.equal(network.state_dict()[name], theirs[name]) for name in theirs)


def test_the_values_of_a_policy_gradient_go_on_if_asked_for(tmp_path: Path) -> None:
    def begun(folder: Path, **settings: object) -> PolicyGradient:
        own = {"agent.learner": "policy_gradient", "agent.n_step": 1, "train.decisions": 1}
        own["agent.policy_gradient.decisions"] = 100
        new = trainer(short_config(**{**own, **settings}), folder)
        new.run()
        assert isinstance(new.agent, PolicyGradient)
        return new.agent

    first = begun(tmp_path / "first").values.state_dict()
    later = {"agent.start_from": str(tmp_path / "first"), "seed": 8}
    kept = begun(tmp_path / "kept", **later, **{VALUES: True}).values.state_dict()
    assert all(torch.equal(kept[name], first[name]) for name in first)
    fresh = begun(tmp_path / "fresh", **later).values.state_dict()
    assert not all(torch.equal(fresh[name], first[name]) for name in first)
    other = {"agent.gamma": 0.9, "rewards.end.weight": 2.0}
    with pytest.raises(
        ConfigError, match=r"of other returns, by agent\.gamma, rewards\.end; train"
    ):
        begun(tmp_path / "other", **later, **{VALUES: True}, **other)


def test_the_values_of_another_decision_than_the_policy_are_refused(tmp_path: Path) -> None:
    settings: dict[str, object] = {"agent.learner": "policy_gradient", "agent.n_step": 1}
    settings |= {"agent.policy_gradient.decisions": 100, "train.decisions": 1}
    trainer(short_config(**settings), tmp_path).run()
    best = checkpoint.read(tmp_path / checkpoint.BEST)
    older = best.document.model_copy(update={"decision": 0})
    checkpoint.write(tmp_path / checkpoint.BEST, older, best.tensors)
    with pytest.raises(ConfigError, match=r"decision 0, its values are those of decision 1; give"):
        preflight.check(
            short_config(**settings, **{"agent.start_from": str(tmp_path), VALUES: True})
        )
    last = str(tmp_path / checkpoint.LAST)
    preflight.check(short_config(**settings, **{"agent.start_from": last, VALUES: True}))


def test_a_run_without_values_is_refused_before_the_training_begins(short_run: Path) -> None:
    settings = {"agent.learner": "policy_gradient", "agent.n_step": 1, VALUES: True}
    settings["agent.policy_gradient.decisions"] = 100
    config = short_config(**{"agent.start_from": str(short_run), **settings})
    text = rf"^{VALUES}: .*short_run\S* has no values; name in agent\.start_from the run of"
    with pytest.raises(ConfigError, match=text):
        preflight.check(config)


def test_a_dropout_may_differ(tmp_path: Path) -> None:
    def begun(folder: Path, **settings: object) -> Learner:
        new = trainer(short_config(**{"train.decisions": 1, **settings}), folder)
        new.run()
        return new.agent

    first = begun(tmp_path / "first", network={"name": "stacked", "dropout": 0.1})
    later = {"network": {"name": "stacked"}, "agent.start_from": str(tmp_path / "first")}
    second = begun(tmp_path / "second", **later)
    inputs = torch.rand(4, first.online.state_dict()["0.scale"].numel())
    assert torch.equal(first.online.eval()(inputs), second.online.eval()(inputs))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"network": {"name": "mlp"}}, "has another network than this training"),
        ({"perception.bins": 12}, "the policy was trained on 15 bins of"),
    ],
)
def test_another_network_or_observation_is_refused(
    short_run: Path, settings: dict[str, object], text: str
) -> None:
    config = short_config(**{"agent.start_from": str(short_run), **settings})
    with pytest.raises(RequestError, match=text):
        preflight.check(config)


def test_a_missing_file_is_refused_by_the_name_of_the_setting() -> None:
    with pytest.raises(
        CheckpointError, match=r"^agent\.start_from: .*nothing: there is no such run"
    ):
        preflight.check(short_config(**{"agent.start_from": "nothing"}))


def test_the_same_weights_in_another_arrangement_are_refused() -> None:
    """The network has the same shapes if one of the earlier observations is another one."""
    trained = checkpoint.read(checkpoint.find(Path("generalist"))).policy_config()
    network: dict[str, Any] = dict(to_dict(trained.network))
    config = {"agent.start_from": "generalist", "network": network}
    preflight.check(short_config(**config))
    network["earlier"] = [4, *network["earlier"][1:]]
    with pytest.raises(ConfigError, match=r"network and settings of the network$"):
        preflight.check(short_config(**config))
