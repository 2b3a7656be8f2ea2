"""``teacher.final_updates``: at its end, a training learns all labels anew."""

import shutil
from pathlib import Path

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import Teacher, TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.policies.trained import policy_module
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


class _Notes:
    """A listener that keeps the notes."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def episode(self, row: dict[str, object]) -> None:
        """Ignore an episode."""

    def validation(self, row: dict[str, object]) -> None:
        """Ignore a validation."""

    def note(self, text: str) -> None:
        """Keep a note."""
        self.notes.append(text)

    def close(self) -> None:
        """Do nothing."""


class _Deleting(_Notes):
    """A listener that deletes a file after the first episode."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self._file = file

    def episode(self, row: dict[str, object]) -> None:
        """Delete the file."""
        self._file.unlink(missing_ok=True)


def config(updates: int, **more: object) -> TrainConfig:
    """A training that only imitates a rule, which drives all of its episodes."""
    settings = {"controller": {"name": "okada"}, "td_weight": 0.0, "student_share": 0.0}
    teacher = {f"teacher.{name}": value for name, value in settings.items()}
    return short_config(**{**teacher, "teacher.final_updates": updates, **more})


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
    often = trained(tmp_path / "often", config(200))
    seldom = trained(tmp_path / "seldom", config(200, **{"agent.update_every": 100}))
    without = trained(tmp_path / "without", config(0, **{"agent.update_every": 100}))
    for name, found in (("often", often), ("seldom", seldom)):
        for key, tensor in found.part("target").items():
            assert torch.equal(tensor, often.part("target")[key]), (name, key)
    assert cross_entropy(seldom) < 0.8 * cross_entropy(without)


def test_a_stop_in_it_changes_nothing(tmp_path: Path) -> None:
    settings = config(100)
    trained(tmp_path / "whole", settings)
    first = trainer(settings, tmp_path / "parts")
    first.listeners.append(notes := _Notes())
    summary = first.run(stop=lambda: first.progress.decision >= 600)
    assert not summary["finished"]
    assert notes.notes == ["learns the 598 labels anew in 100 updates"]
    stopped = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    second = trainer(stopped.config(), tmp_path / "parts")
    second.listeners.append(notes)
    second.restore(stopped)
    assert second.run()["finished"]
    for name in (checkpoint.BEST, checkpoint.LAST):
        parts, at_once = tmp_path / "parts" / name, tmp_path / "whole" / name
        assert parts.read_bytes() == at_once.read_bytes(), name
    assert [text.split(" updates, ")[0] for text in notes.notes[2:]] == [
        "28 of 100",
        "52 of 100",
        "76 of 100",
    ]


def test_it_begins_with_the_weights_that_the_training_began_with(
    short_run: Path, tmp_path: Path
) -> None:
    """The file that it started from may change, or go, while it trains."""
    copy = tmp_path / "start.safetensors"
    shutil.copy(short_run / checkpoint.BEST, copy)
    first = trainer(config(3, **{"agent.start_from": str(copy)}), tmp_path / "first")
    first.listeners.append(_Deleting(copy))
    assert first.run()["finished"]
    assert not copy.exists()
    trained(tmp_path / "kept", config(3, **{"agent.start_from": str(short_run)}))
    found, expected = (
        checkpoint.read(tmp_path / name / checkpoint.LAST).part("online")
        for name in ("first", "kept")
    )
    assert all(torch.equal(found[name], expected[name]) for name in expected)


def test_a_resumed_run_begins_with_them_too(short_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "start.safetensors"
    shutil.copy(short_run / checkpoint.BEST, copy)
    settings = config(3, **{"agent.start_from": str(copy)})
    trained(tmp_path / "whole", settings)
    first = trainer(settings, tmp_path / "parts")
    first.run(stop=lambda: first.progress.decision >= 200)
    copy.unlink()
    stopped = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    second = trainer(stopped.config(), tmp_path / "parts")
    second.restore(stopped)
    assert second.run()["finished"]
    for name in (checkpoint.BEST, checkpoint.LAST):
        parts, at_once = tmp_path / "parts" / name, tmp_path / "whole" / name
        assert parts.read_bytes() == at_once.read_bytes(), name


def test_without_labels_it_keeps_what_was_learnt(tmp_path: Path) -> None:
    new = trainer(config(3, **{"train.decisions": 100}), tmp_path)
    new.listeners.append(notes := _Notes())
    before = {name: tensor.clone() for name, tensor in new.agent.online.state_dict().items()}
    assert new._relearning.run(new.agent, lambda: False)
    assert notes.notes == ["keeps what it has learnt: there are no labels to learn anew"]
    assert all(torch.equal(t, before[n]) for n, t in new.agent.online.state_dict().items())


@pytest.mark.parametrize("more", [{}, {"td_weight": 0, "loss": "values"}])
def test_it_is_refused_where_there_is_more_than_labels(more: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"teacher\.final_updates: 5 updates learn from labels"):
        Teacher(controller="okada", final_updates=5, **more)
