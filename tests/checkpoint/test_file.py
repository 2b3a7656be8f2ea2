"""Checkpoint files: damaged, foreign, dangerous and wrong ones are refused with one clear error."""

import json
import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file

from flipperctl import checkpoint
from flipperctl.api import registry
from flipperctl.checkpoint import former
from flipperctl.checkpoint.document import FORMAT
from flipperctl.config.models import AbsentTerrain
from flipperctl.errors import CheckpointError
from flipperctl.policies.trained import policy_module
from flipperctl.training import listeners as timing
from tests.cli.call import call
from tests.short import few, trainer


@pytest.fixture
def best(short_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(short_run / checkpoint.BEST, tmp_path / "best.safetensors"))


@pytest.fixture
def last(short_run: Path, tmp_path: Path) -> Path:
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    return Path(shutil.copy(short_run / checkpoint.LAST, tmp_path / "run" / checkpoint.LAST))


def resign(path: Path, changes: dict[str, object]) -> None:
    """Change the document (``"state.orders.0.seed": 3``; ``...`` deletes) and its checksum."""
    saved = checkpoint.read(path)
    document = saved.document.plain()
    for key, value in changes.items():
        *parents, leaf = (int(part) if part.isdecimal() else part for part in key.split("."))
        node: Any = document
        for parent in parents:
            node = node[parent]
        if value is ...:
            del node[leaf]
        else:
            node[leaf] = value
    path.write_bytes(checkpoint.serialize(json.dumps(document), saved.tensors))


def test_a_checkpoint_describes_itself(best: Path) -> None:
    saved = checkpoint.read(best)
    assert saved.document.format == FORMAT
    assert saved.document.config.terrain.name == "step"
    assert saved.document.versions["torch"] == torch.__version__
    (network,) = [p for p in saved.document.plugins if p.kind == "network"]
    assert (network.name, network.module) == ("at_d3qn", "flipperctl_plugins.networks.d3qn")
    assert saved.config().seed == 7


@pytest.mark.usefixtures("registry")
def test_a_policy_is_read_again_when_its_file_or_the_plugins_change(best: Path) -> None:
    first = checkpoint.read_policy(best)
    assert checkpoint.read_policy(best) is first
    config = first.policy_config()
    assert first.policy_config() is config
    del registry["terrain", "step"]
    assert isinstance(first.policy_config().terrain, AbsentTerrain)
    resign(best, {"config.seed": 8})
    assert checkpoint.read_policy(best).document.config.seed == 8
    best.unlink()
    with pytest.raises(CheckpointError, match="there is no such checkpoint"):
        checkpoint.read_policy(best)


def test_every_flipped_bit_and_a_missing_end_are_found(best: Path) -> None:
    data = best.read_bytes()
    for size in (0, 500, -1):
        best.write_bytes(data[:size])
        with pytest.raises(CheckpointError, match="damaged"):
            checkpoint.read(best)
    # Some in the header, in the document, in the digest, in the weights.
    for at in (0, 9, 100, 2000, len(data) // 2, len(data) - 1):
        best.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(CheckpointError, match=r"damaged|no checkpoint"):
            checkpoint.read(best)


def test_a_foreign_safetensors_file_is_refused(tmp_path: Path) -> None:
    save_file({"weight": torch.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(CheckpointError, match="not a checkpoint of flipperctl"):
        checkpoint.read(tmp_path / "other.safetensors")


class Mine:
    """Creates a folder if it is ever unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.trace),)


@pytest.mark.parametrize("how", ["pickle", "torch"])
def test_a_pickle_is_refused_and_never_executed(tmp_path: Path, how: str) -> None:
    path, trace = tmp_path / "best.safetensors", tmp_path / "executed"
    if how == "pickle":
        path.write_bytes(pickle.dumps(Mine(trace)))
    else:
        torch.save(Mine(trace), path)
    with pytest.raises(CheckpointError, match="never loads"):
        checkpoint.read(path)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Mine(trace)))  # the trap does work
    assert trace.exists()


def test_a_header_whose_length_looks_like_a_pickle_is_read(best: Path) -> None:
    for padding in range(256):  # until the length's lowest byte is a pickle's first, 0x80
        resign(best, {"versions.padding": "x" * padding})
        if best.read_bytes()[:1] == b"\x80":
            break
    assert best.read_bytes()[:1] == b"\x80"
    assert checkpoint.read(best).document.versions["padding"] == "x" * padding


def test_equal_contents_are_equal_files(best: Path) -> None:
    saved = checkpoint.read(best)
    # safetensors itself gives the two entries of the metadata in one of two orders, by chance.
    files = {checkpoint.serialize(saved.document.text(), saved.tensors) for _ in range(12)}
    assert files == {best.read_bytes()}


def test_the_content_hash_covers_results_and_weights(best: Path) -> None:
    content = checkpoint.read(best).content
    resign(best, {"versions.torch": "9.9", "config.logger": {}})
    assert checkpoint.read(best).content == content
    resign(best, {"validation.t_cost": 1.0})
    assert checkpoint.read(best).content != content


def test_a_run_directory_stands_for_its_checkpoint(short_run: Path, tmp_path: Path) -> None:
    assert checkpoint.find(short_run) == short_run / checkpoint.BEST
    assert checkpoint.find(short_run, checkpoint.LAST) == short_run / checkpoint.LAST
    with pytest.raises(CheckpointError, match="is it a run directory"):
        checkpoint.find(tmp_path)
    last = tmp_path / "0_seed=1" / checkpoint.LAST
    last.parent.mkdir(parents=True)
    last.touch()
    with pytest.raises(CheckpointError, match=r"one of its runs, such as .*0_seed=1"):
        checkpoint.find(tmp_path)
    with pytest.raises(CheckpointError, match=r"did you mean '.*/0_seed=1'\?"):
        checkpoint.find(tmp_path / "0_sed=1")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"config": ...}, "document.config: Field required"),
        ({"padding": "x"}, "document.padding: there is no such key"),
        ({"validation": ...}, "belong to the kind 'best'"),
        ({"validation.success_rate": 1.5}, "document.validation.success_rate: "),
    ],
)
def test_a_wrong_document_is_named_by_its_path(
    changes: dict[str, Any], expected: str, best: Path
) -> None:
    resign(best, changes)
    with pytest.raises(CheckpointError) as caught:
        checkpoint.read(best)
    assert expected in str(caught.value)
    assert str(best) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "it must be a mapping; it is a list"),
        ("[" * 100_000, "nested too deeply"),
        ('{"format": 2, "format": 2}', "the key 'format' twice"),
        (f'{{"format": {FORMAT}, "kind": "\\ud800"}}', "document: Invalid JSON"),
        (f'{{"format": {FORMAT}, "kind": ' + "[" * 300 + "]" * 300 + "}", "recursion limit"),
    ],
)
def test_text_that_is_not_a_document_is_refused(text: str, expected: str, best: Path) -> None:
    best.write_bytes(checkpoint.serialize(text, checkpoint.read(best).tensors))
    with pytest.raises(CheckpointError, match="its document is not valid") as caught:
        checkpoint.read(best)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"state": ...}, "a state belongs to the kind 'last', and to no other"),
        ({"state.generators.explore.state.state": 1 << 128}, "explore.state.state: "),
        ({"state.orders": [[0, 1, 0.5, 0, 0, 1.0]]}, "document.state.orders.0: "),
    ],
)
def test_a_wrong_state_is_named_by_its_path(
    changes: dict[str, Any], expected: str, last: Path
) -> None:
    resign(last, changes)
    with pytest.raises(CheckpointError) as caught:
        checkpoint.read(last)
    assert expected in str(caught.value)


def changed(path: Path, name: str, tensor: torch.Tensor) -> checkpoint.Checkpoint:
    saved = checkpoint.read(path)
    checkpoint.write(path, saved.document, {**saved.tensors, name: tensor})
    return checkpoint.read(path)


@pytest.mark.parametrize(
    ("name", "tensor", "expected"),
    [
        ("replay.reward", torch.zeros(3), r"replay is not valid: reward is float32 \(3,\); flo"),
        ("replay.action", torch.full((300,), 9), r"replay is not valid: action is int64 \(300,\)"),
        ("optimiser.third", torch.zeros(3), "there is no tensor 'third'"),
        ("online.1.joined.0.bias", torch.zeros(1), r"online is not valid: 1\.joined\.0\.bias is "),
    ],
)
def test_a_run_is_resumed_only_from_its_own_tensors(
    name: str, tensor: torch.Tensor, expected: str, last: Path
) -> None:
    saved = changed(last, name, tensor)
    with pytest.raises(CheckpointError, match=expected):
        trainer(few(), last.parents[1]).restore(saved)


def test_weights_that_do_not_fit_are_refused(best: Path) -> None:
    name = "policy.1.joined.0.bias"
    infinite = torch.full_like(checkpoint.read(best).tensors[name], float("inf"))
    with pytest.raises(CheckpointError, match=r"1\.joined\.0\.bias holds numbers that are not"):
        policy_module(changed(best, name, infinite))
    resign(best, {"config.network.head": 32})
    with pytest.raises(CheckpointError, match="do not fit network 'at_d3qn'"):
        policy_module(checkpoint.read(best))
    with pytest.raises(CheckpointError, match=r"a tensor is named 'more\.x'"):
        changed(best, "more.x", torch.zeros(1))


def test_a_checkpoint_of_another_version_is_refused_in_one_line(last: Path) -> None:
    saved = checkpoint.read(last)
    text = json.dumps({**saved.document.plain(), "format": 2})
    last.write_bytes(checkpoint.serialize(text, saved.tensors))
    done = call("inspect", "checkpoint", str(last), cwd=last.parent)
    refused = "its format is 2, of another version of flipperctl; this one reads 3; train or record"
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert refused in done.err


FORMER = {
    "d3qn": ({"learner": "d3qn", "n_step": 2, "policy_gradient": {"value_passes": 8}}, None),
    "policy_gradient": (
        {"learner": "policy_gradient", "n_step": 1, "policy_gradient": {"clip": 0.2}},
        None,
    ),
    "sb3": ({"learner": "d3qn"}, {"name": "sb3", "algorithm": "sac", "settings": {"tau": 0.1}}),
}
"""Learner → ``agent`` and ``method`` before learners were plugins."""


@pytest.mark.parametrize("name", FORMER)
def test_the_learner_of_a_former_file_is_a_plugin_now(name: str) -> None:
    agent, method = FORMER[name]
    sim = {"name": "planar", "engine": "compiled"}
    config = {"sim": sim, "agent": {"gamma": 0.9, **agent}, "method": method}
    read = former.current(config)
    assert read["sim"] == {"name": "planar"}
    assert (read["agent"]["name"], read["agent"]["gamma"]) == (name, 0.9)
    assert read["agent"].get("n_step") == (2 if name == "d3qn" else None)
    assert read["agent"].get("clip") == (0.2 if name == "policy_gradient" else None)
    assert read["agent"].get("algorithm") == ("sac" if name == "sb3" else None)
    assert former.current(read) == read


@pytest.mark.parametrize(("candidates", "priority"), [(1, None), (4, 0.6)])
def test_candidates_of_a_former_file_are_priorities_now(
    candidates: int, priority: float | None
) -> None:
    read = former.current({"agent": {"name": "d3qn", "candidates": candidates}})
    assert read["agent"].get("priority") == priority
    assert "candidates" not in read["agent"]


def test_a_run_with_candidates_is_evaluated_and_not_resumed(last: Path) -> None:
    saved = checkpoint.read(last)
    agent = {**saved.document.plain()["config"]["agent"], "candidates": 4}
    resign(last, {"config.agent": {k: v for k, v in agent.items() if "priority" not in k}})
    old = checkpoint.read(last)
    assert policy_module(old).state_dict().keys() == saved.part("target").keys()
    with pytest.raises(CheckpointError, match="its part replay is not valid: priority is missing"):
        trainer(old.config(), last.parents[1]).restore(old)


def test_a_run_from_before_learners_were_plugins_is_evaluated_and_not_resumed(last: Path) -> None:
    saved = checkpoint.read(last)
    state = saved.document.plain()["state"]
    counts = {"replay_added": 300, "replay_kept": 0, "groups_added": 0}
    before = {k: v for k, v in state.items() if k not in ("parts", "learner")} | counts
    agent = {"learner": "d3qn", "n_step": 3, "policy_gradient": {"clip": 0.15}}
    resign(last, {"state": before, "config.agent": agent, "config.method": None})
    old = checkpoint.read(last)
    assert policy_module(old).state_dict().keys() == saved.part("target").keys()
    with pytest.raises(CheckpointError, match=r"its state is not valid: its part online"):
        trainer(few(), last.parents[1]).restore(old)


def test_the_time_continues_when_a_run_is_resumed(last: Path) -> None:
    run = last.parents[1]
    (run / timing.NAME).write_text('{"seconds": 100.0}')
    learner = trainer(few(**{"train.decisions": 310}), run)
    learner.restore(checkpoint.read(last))
    total = learner.run()["seconds"]
    assert 100 < total < 160
    kept = (run / timing.NAME).read_text()
    broken = ("", "[]", '{"seconds": "x"}', '{"seconds": -1}', '{"seconds": NaN}', 9999 * "[")
    for text, seconds in ((kept, total), *((text, 0.0) for text in broken)):
        (run / timing.NAME).write_text(text)
        assert timing.Companion(run).read().seconds == pytest.approx(seconds, abs=1)
