"""Files of recorded episodes: they hold what was written; damaged and foreign ones are refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import Outcome, RecordedEpisode
from flipperctl.checkpoint import document as sealed
from flipperctl.checkpoint import recording
from flipperctl.config import EnvConfig, with_overrides
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.text.files import check_output

STEP, FLAT = EnvConfig(terrain="step"), EnvConfig(terrain="flat")


def episode(number: int, decisions: int) -> RecordedEpisode:
    """An episode whose numbers count up from its number."""
    size = STEP.perception.layout.size
    observations = np.arange((decisions + 1) * size, dtype=np.float32).reshape(-1, size) + number
    labels = np.zeros((decisions, 9), np.float32)
    labels[1:, 2] = 0.25
    labels[1:, 3] = 0.75  # the first decision has no label
    return RecordedEpisode(
        number,
        1000 + number,
        f"drawn {number}",
        Outcome.STUCK,
        observations,
        np.arange(decisions) % 9,
        np.arange(decisions) / 3 - number,
        labels,
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "driven.safetensors"
    recording.write(
        path, "okada", [(STEP, [episode(0, 3), episode(1, 1)]), (FLAT, [episode(7, 2)])]
    )
    return path


def change(path: Path, changes: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
    """Change the document and the tensors, and write a new checksum."""
    text, found = sealed.read(path, "file")
    document = {**json.loads(text), **changes}
    path.write_bytes(sealed.serialize(json.dumps(document), {**found, **tensors}))


def test_a_file_holds_what_was_written(file: Path) -> None:
    found = recording.read(file)
    assert found.document.driver == "okada"
    assert [e.environment for e in found.document.episodes] == [0, 0, 1]
    terrains = [e.model_dump()["terrain"]["name"] for e in found.document.environments]
    assert terrains == ["step", "flat"]
    assert found.decisions == 6
    for read, written in zip(
        found.episodes, [episode(0, 3), episode(1, 1), episode(7, 2)], strict=True
    ):
        for name in ("number", "seed", "terrain", "outcome"):
            assert getattr(read, name) == getattr(written, name)
        for name in ("observations", "actions", "rewards", "labels"):
            ours, theirs = getattr(read, name), getattr(written, name)
            assert ours.dtype == theirs.dtype
            assert np.array_equal(ours, theirs)


def test_equal_episodes_give_equal_files_and_none_give_an_empty_one(
    file: Path, tmp_path: Path
) -> None:
    again = tmp_path / "again.safetensors"
    found = recording.read(file)
    recording.write(again, "okada", [(STEP, found.episodes[:2]), (FLAT, found.episodes[2:])])
    assert again.read_bytes() == file.read_bytes()
    check_output(again, recording.KIND)  # one of before is replaced
    recording.write(again, "nobody", [(STEP, [])])
    assert recording.read(again).episodes == ()


@pytest.mark.parametrize("change", [{"bins": 21}, {"highest": False}])
def test_one_file_has_one_observation_layout(change: dict[str, Any], tmp_path: Path) -> None:
    other = with_overrides(STEP, {"perception": change})
    with pytest.raises(ConfigError, match="has one observation layout; the environments have 2"):
        recording.write(tmp_path / "x", "okada", [(STEP, []), (other, [])])


def test_a_checkpoint_is_no_recording_and_the_reverse(short_run: Path, file: Path) -> None:
    with pytest.raises(CheckpointError, match=r"its kind is 'best'.*is it a checkpoint"):
        recording.read(short_run / checkpoint.BEST)
    with pytest.raises(CheckpointError, match="recorded episodes, which hold no policy"):
        checkpoint.read(file)
    with pytest.raises(CheckpointError, match="there is no such file of recorded episodes"):
        recording.read(file.with_name("none"))


LABELS = torch.full((6, 9), 1 / 9)


@pytest.mark.parametrize(
    ("changes", "tensors", "text"),
    [
        ({"format": 3}, {}, "its format is 3, of another version .*; this one reads 2"),
        ({"environments": []}, {}, "environment is 0; there are 0"),
        ({"episodes": []}, {}, r"observation is float32 \(\d+, \d+\); float32 \(0, "),
        ({}, {"action": torch.full((6,), 9)}, "action lies outside of 0 to 8"),
        ({}, {"label": LABELS / 2}, "neither a distribution nor zeros"),
    ],
)
def test_wrong_contents_are_refused_though_their_checksum_fits(
    file: Path, changes: dict[str, Any], tensors: dict[str, torch.Tensor], text: str
) -> None:
    change(file, changes, tensors)
    with pytest.raises(CheckpointError, match=text):
        recording.read(file)


def test_an_outline_of_endless_episodes_takes_no_memory(file: Path) -> None:
    document = recording.read(file).document.model_dump(mode="json")
    document["episodes"][0]["decisions"] = 2**31 - 1
    change(file, document, {})
    with pytest.raises(CheckpointError, match="its tensors are not valid"):
        recording.read(file)
