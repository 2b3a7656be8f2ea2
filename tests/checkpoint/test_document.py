"""Documents of any origin: one error names each fault by its path."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.errors import CheckpointError
from flipperctl.policies.trained import policy_module
from flipperctl.training import listeners as timing
from tests.checkpoint.test_file import resign
from tests.cli.call import call
from tests.short import short_config, trainer


@pytest.fixture
def best(short_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(short_run / checkpoint.BEST, tmp_path / "best.safetensors"))


@pytest.fixture
def last(short_run: Path, tmp_path: Path) -> Path:
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    return Path(shutil.copy(short_run / checkpoint.LAST, tmp_path / "run" / checkpoint.LAST))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"config": ...}, "document.config: Field required"),
        ({"config.rewards.end.weight": None}, "document.config.rewards.end.weight: "),
        ({"config.seed": True}, "document.config.seed: Input should be a valid integer"),
        ({"kind": "better"}, "document.kind: Input should be 'best' or 'last'"),
        ({"plugins.0.name": "a\nb"}, "document.plugins.0.name: String should match"),
        (
            {"actions.joints": ["left", "right"]},
            "document.actions: the actions turn left, right in",
        ),
        ({"padding": "x"}, "document.padding: there is no such key"),
        ({"decision": 1 << 70}, "document.decision: "),
        ({"validation": ...}, "belong to the kind 'best'"),
        ({"validation.success_rate": 1.5}, "document.validation.success_rate: "),
        ({"state": {}}, "document.state"),
    ],
)
def test_a_wrong_document_is_named_by_its_path(
    changes: dict[str, Any], expected: str, best: Path
) -> None:
    resign(best, changes)
    for read in (checkpoint.read, lambda path: policy_module(checkpoint.read(path))):
        with pytest.raises(CheckpointError) as caught:
            read(best)
        assert expected in str(caught.value)
        assert str(best) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "it must be a mapping; it is a list"),
        ("[" * 100_000, "nested too deeply"),
        ('{"format": 2, "format": 2}', "the key 'format' twice"),
        ('{"format": true}', "its format is True"),
        ('{"format": 1e999}', "it holds 1e999"),
        ('{"format": 2, "kind": "\\ud800"}', "document: Invalid JSON"),
        ('{"format": 2, "kind": ' + "[" * 300 + "]" * 300 + "}", "recursion limit"),
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
        ({"state.recent": [True] * 101}, "document.state.recent: "),
        ({"state.validations.0.pitch_variation": None}, "state.validations.0.pitch_variation: "),
        ({"state.lost": 10**6}, "lost is 1000000, above started"),
        ({"state.replay_added": 601}, "replay_added is 601, above decision"),
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


def changed(last: Path, name: str, tensor: torch.Tensor) -> checkpoint.Checkpoint:
    saved = checkpoint.read(last)
    tensors = {k: v for k, v in saved.tensors.items() if k != name}
    tensors[name] = tensor
    checkpoint.write(last, saved.document, tensors)
    return checkpoint.read(last)


@pytest.mark.parametrize(
    ("name", "tensor", "expected"),
    [
        (
            "replay.reward",
            torch.zeros(3),
            r"replay is not valid: reward is float32 \(3,\); flo",
        ),
        ("replay.action", torch.full((600,), 9), r"replay is not valid: action is int64 \(600,\)"),
        ("optimiser.third", torch.zeros(3), "there is no tensor 'third'"),
        ("online.1.joined.0.bias", torch.zeros(1), r"online is not valid: 1\.joined\.0\.bias is "),
    ],
)
def test_a_run_is_resumed_only_from_its_own_tensors(
    name: str, tensor: torch.Tensor, expected: str, last: Path
) -> None:
    saved = changed(last, name, tensor)
    with pytest.raises(CheckpointError, match=expected):
        trainer(short_config(), last.parents[1]).restore(saved)


def test_a_tensor_of_an_unknown_part_is_refused(best: Path) -> None:
    saved = checkpoint.read(best)
    checkpoint.write(best, saved.document, {**saved.tensors, "more.x": torch.zeros(1)})
    with pytest.raises(CheckpointError, match=r"a tensor is named 'more\.x'"):
        checkpoint.read(best)


def test_weights_that_are_not_finite_are_refused(best: Path) -> None:
    saved = checkpoint.read(best)
    name = "policy.1.joined.0.bias"
    tensors = {**saved.tensors, name: torch.full_like(saved.tensors[name], float("inf"))}
    checkpoint.write(best, saved.document, tensors)
    with pytest.raises(CheckpointError, match=r"1\.joined\.0\.bias holds numbers that are not"):
        policy_module(checkpoint.read(best))


@pytest.mark.parametrize(
    ("version", "changes"), [("0.1", {"format": 1}), ("0.2", {"actions": None})]
)
def test_a_checkpoint_of_an_earlier_version_is_refused_in_one_line(
    version: str, changes: dict[str, Any], last: Path
) -> None:
    saved = checkpoint.read(last)
    changed = {**saved.document.plain(), **changes}
    text = json.dumps({k: v for k, v in changed.items() if v is not None})
    last.write_bytes(checkpoint.serialize(text, saved.tensors))
    done = call("inspect", "checkpoint", str(last), cwd=last.parent)
    refused = f"last.safetensors is of version {version}; this version reads 0.3; train again"
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert refused in done.err


def elapsed(run: Path) -> float:
    """Return the time that the run has taken so far [s]."""
    stopwatch = timing.Stopwatch(run)
    stopwatch.read()
    return stopwatch.seconds


def test_the_time_continues_when_a_run_is_resumed(last: Path) -> None:
    run = last.parents[1]
    (run / timing.NAME).write_text('{"seconds": 100.0}')
    learner = trainer(short_config(**{"train.decisions": 650}), run)
    learner.restore(checkpoint.read(last))
    summary = learner.run()
    assert 100 < summary["seconds"] < 160
    assert elapsed(run) == pytest.approx(summary["seconds"], abs=1)
    for text in ("", "[]", '{"seconds": "x"}', '{"seconds": -1}', '{"seconds": NaN}'):
        (run / timing.NAME).write_text(text)
        assert elapsed(run) == pytest.approx(0.0, abs=1)
