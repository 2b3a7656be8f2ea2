"""A training that starts with the weights of another one, or that learns its labels anew."""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import Teacher, TrainConfig, to_dict
from flipperctl.core.targets import ACTIONS, actions_of
from flipperctl.errors import CheckpointError, ConfigError, RequestError
from flipperctl.learners.clipped import GradientLearning
from flipperctl.policies.trained import policy_module
from flipperctl.training import run as training_run
from flipperctl.training.trainer import Trainer
from tests.rollout.notes import Notes
from tests.short import few, short_config, trainer
from tests.training.conftest import GRADIENT, require_same_end

pytestmark = pytest.mark.slow

VALUES = "agent.start_values"


def begun(folder: Path, **settings: object) -> Trainer:
    """Return a training after its first decision."""
    new = trainer(few(**{"train.decisions": 1, **settings}), folder)
    new.run()
    return new


def test_the_networks_start_with_the_weights_of_the_run(
    runs: Callable[[str], Path], tmp_path: Path
) -> None:
    start = {"agent.start_from": str(runs("stacked"))}
    new = begun(tmp_path, network={"name": "stacked"}, **start)  # its dropout may differ
    best = checkpoint.read(runs("stacked") / checkpoint.BEST)
    theirs = list(policy_module(best).state_dict().values())
    for network in (new.learning.driving, new.learning.policy):
        ours = list(network.state_dict().values())
        assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_a_policy_that_now_sees_both_sides_begins_as_it_was(
    runs: Callable[[str], Path], tmp_path: Path
) -> None:
    start = {"agent.start_from": str(runs("stacked")), "network": {"name": "stacked"}}
    new = begun(tmp_path, **start, **{"perception.sides": True})
    old = policy_module(checkpoint.read(runs("stacked") / checkpoint.BEST))
    # Two frames of 30 heights, 60 below the sides, the roll and three angles; any sides are alike
    wide = torch.randn((8, 3, 94))
    narrow = torch.cat([wide[..., :30], wide[..., 91:]], dim=2)
    with torch.inference_mode():
        ours, theirs = new.learning.policy(wide.flatten(1)), old(narrow.flatten(1))
    assert torch.allclose(ours, theirs, atol=1e-5)
    # Nor does a policy with sides start one without
    back = {"agent.start_from": str(tmp_path), "network": {"name": "stacked"}}
    with pytest.raises(CheckpointError, match=r"was trained on .*sides=true; perception asks"):
        training_run.check(few(**back))


def test_four_flippers_begin_as_the_pairs_turned(
    runs: Callable[[str], Path], tmp_path: Path
) -> None:
    start = {"agent.start_from": str(runs("stacked")), "network": {"name": "stacked"}}
    four = {"sim": "mujoco", "robot.flippers": "four", "perception.sides": True}
    new = begun(tmp_path, **start, **four)
    old = policy_module(checkpoint.read(runs("stacked") / checkpoint.BEST))
    # Heights, those below the sides, the roll, four angles and the pitch
    wide = torch.randn((8, 3, 96))
    front, rear = wide[..., 91:93].mean(2, keepdim=True), wide[..., 93:95].mean(2, keepdim=True)
    narrow = torch.cat([wide[..., :30], front, rear, wide[..., 95:]], dim=2)
    with torch.inference_mode():
        ours, theirs = new.learning.policy(wide.flatten(1)), old(narrow.flatten(1))
    # Each side turns as the pairs did
    for action, turns in enumerate(actions_of(4)):
        left, right = (theirs[:, ACTIONS.index((turns[i], turns[i + 2]))] for i in range(2))
        assert torch.allclose(ours[:, action], (left + right) / 2, atol=1e-4)


def test_the_values_of_a_policy_gradient_go_on_if_asked_for(tmp_path: Path) -> None:
    def values(folder: str, **settings: object) -> list[torch.Tensor]:
        learning = begun(tmp_path / folder, **{**GRADIENT, **settings}).learning
        assert isinstance(learning, GradientLearning)
        return list(learning.agent.values.state_dict().values())

    first = values("first")
    later = {"agent.start_from": str(tmp_path / "first"), "seed": 8}
    kept, fresh = values("kept", **later, **{VALUES: True}), values("fresh", **later)
    assert all(torch.equal(a, b) for a, b in zip(kept, first, strict=True))
    assert not all(torch.equal(a, b) for a, b in zip(fresh, first, strict=True))
    other = {"agent.gamma": 0.9, "rewards.end.weight": 2.0}
    with pytest.raises(
        ConfigError, match=r"of other returns, by agent\.gamma, rewards\.end\.weight; train"
    ):
        values("other", **later, **{VALUES: True}, **other)
    best = checkpoint.read(tmp_path / "first" / checkpoint.BEST)
    older = best.document.model_copy(update={"decision": 0})
    checkpoint.write(tmp_path / "first" / checkpoint.BEST, older, best.tensors)
    with pytest.raises(ConfigError, match=r"decision 0, its values are those of decision 1; give"):
        training_run.check(few(**{**GRADIENT, **later, VALUES: True}))
    last = {"agent.start_from": str(tmp_path / "first" / checkpoint.LAST)}
    training_run.check(few(**{**GRADIENT, **last, VALUES: True}))


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"network": {"name": "mlp"}}, "has another network than this training"),
        ({"perception.bins": 12}, "the policy was trained on bins=15, "),
        ({"agent.start_from": "nothing"}, r"^agent\.start_from: .*nothing: there is no such run"),
        (
            {**GRADIENT, VALUES: True},
            rf"^{VALUES}: .* has no values; name in agent\.start_from the run of",
        ),
    ],
)
def test_another_start_is_refused_before_the_training_begins(
    runs: Callable[[str], Path], settings: dict[str, object], text: str
) -> None:
    start = {"agent.start_from": str(runs("conv")), "network": "conv"}
    with pytest.raises((RequestError, CheckpointError), match=text):
        training_run.check(short_config(**{**start, **settings}))


def test_the_same_weights_in_another_arrangement_are_refused() -> None:
    """The network has the same shapes if one of the earlier observations is another one."""
    trained = checkpoint.read(checkpoint.find(Path("generalist"))).policy_config()
    network: dict[str, Any] = dict(to_dict(trained.network))
    layout = trained.perception.layout.model_dump()
    config = {"agent.start_from": "generalist", "network": network, "perception": layout}
    training_run.check(short_config(**config))
    network["earlier"] = [4, *network["earlier"][1:]]
    with pytest.raises(ConfigError, match=r"network and settings of the network$"):
        training_run.check(short_config(**config))


# ``teacher.final_updates``: at its end, a training learns all labels anew.


class Deleting(Notes):
    """A listener that deletes a file after the first episode."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file

    def episode(self, row: Mapping[str, Any]) -> None:
        self._file.unlink(missing_ok=True)


def config(updates: int, **more: object) -> TrainConfig:
    """A training that only imitates a rule, which drives all of its episodes."""
    settings = {"controller": {"name": "okada"}, "td_weight": 0.0, "student_share": 0.0}
    teacher = {f"teacher.{name}": value for name, value in settings.items()}
    return few(**{**teacher, "teacher.final_updates": updates, **more})


def trained(folder: Path, settings: TrainConfig) -> Checkpoint:
    """Train, and return the last checkpoint."""
    trainer(settings, folder).run()
    return checkpoint.read(folder / checkpoint.LAST)


def cross_entropy(last: Checkpoint) -> float:
    """Return that of the policy on the labels of its training."""
    replay = last.part("replay")
    values = policy_module(last)(replay["observation"].flatten(1)) / 0.1
    return float(-(replay["label"] * torch.log_softmax(values, dim=1)).sum(dim=1).mean())


def test_the_policy_is_that_of_the_labels_whatever_drove_before(tmp_path: Path) -> None:
    less = {"train.decisions": 150, "train.validate_every": 150}
    often = trained(tmp_path / "often", config(100, **less))
    seldom = trained(tmp_path / "seldom", config(100, **less, **{"agent.update_every": 100}))
    without = trained(tmp_path / "without", config(0, **less, **{"agent.update_every": 100}))
    for key, tensor in seldom.part("target").items():
        assert torch.equal(tensor, often.part("target")[key]), key
    assert cross_entropy(seldom) < 0.9 * cross_entropy(without)


def test_a_stop_in_it_changes_nothing_and_it_begins_with_the_weights_of_the_start(
    runs: Callable[[str], Path], tmp_path: Path
) -> None:
    """The file that it started from may change, or go, while it trains."""
    copy = tmp_path / "start.safetensors"
    shutil.copy(runs("conv") / checkpoint.BEST, copy)
    settings = config(100, network="conv", **{"agent.start_from": str(copy)})
    trained(tmp_path / "whole", settings)
    first = trainer(settings, tmp_path / "parts")
    first.listeners.append(notes := Deleting(copy))
    assert not first.run(stop=lambda: first.progress.decision >= 300)["finished"]
    assert not copy.exists()
    assert notes.notes == ["learns the 298 labels anew in 100 updates"]
    require_same_end(tmp_path / "whole", tmp_path / "parts", notes)
    told = [text.split(" updates, ")[0] for text in notes.notes[2:]]
    assert told == ["28 of 100", "52 of 100", "76 of 100"]


def test_without_labels_it_keeps_what_was_learnt(tmp_path: Path) -> None:
    new = trainer(config(3), tmp_path)
    new.listeners.append(notes := Notes())
    new.run(stop=lambda: True)
    driving = new.learning.driving
    before = {name: tensor.clone() for name, tensor in driving.state_dict().items()}
    assert new.learning.finish(lambda: False)
    assert notes.notes == ["keeps what it has learnt: there are no labels to learn anew"]
    assert all(torch.equal(t, before[n]) for n, t in driving.state_dict().items())


@pytest.mark.parametrize("more", [{}, {"td_weight": 0, "loss": "values"}])
def test_it_is_refused_where_there_is_more_than_labels(more: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"teacher\.final_updates: 5 updates learn from labels"):
        Teacher(controller="okada", final_updates=5, **more)
