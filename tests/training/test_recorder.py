"""The files in which a training keeps its episodes while it runs."""

import itertools
import shutil
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.checkpoint import recording
from flipperctl.errors import CheckpointError
from flipperctl.training.folder import clear_leftovers
from flipperctl.training.recorder import EPISODES, PARTS
from flipperctl.training.saving import RunSaver
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


def test_each_checkpoint_writes_its_new_episodes_alone_and_a_kill_loses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folders are copied where a kill would leave them: before and after a checkpoint."""
    config = short_config(
        **{"train.record": True, "train.checkpoint_every": 40, "train.decisions": 300}
    )
    whole, save, count = tmp_path / "whole", RunSaver.save, itertools.count()

    def copying(self: RunSaver, outstanding: Any = ()) -> None:
        number = next(count)
        if number == 5:
            shutil.copytree(whole, tmp_path / "before")
        save(self, outstanding)
        if number == 5:
            shutil.copytree(whole, tmp_path / "after")

    monkeypatch.setattr(RunSaver, "save", copying)
    trainer(config, whole).run()
    monkeypatch.undo()
    for folder in (tmp_path / "before", tmp_path / "after"):
        parts = [recording.read(path).episodes for path in sorted((folder / PARTS).iterdir())]
        assert len(parts) >= 3
        saved = checkpoint.read(folder / checkpoint.LAST)
        assert saved.document.state is not None
        written = [episode.number for part in parts for episode in part]
        assert written == list(range(len(written)))
        late = len(written) - saved.document.state.episode
        assert late == (len(parts[-1]) if folder.name == "before" else 0)
        (folder / PARTS / f".{99:08}.safetensors.1-ab.part").touch()
        clear_leftovers(folder)
        resumed = trainer(saved.config(), folder)
        resumed.restore(saved)
        resumed.run()
        for name in (checkpoint.LAST, EPISODES):
            assert (folder / name).read_bytes() == (whole / name).read_bytes()
        assert not (folder / PARTS).exists()


def test_a_damaged_recording_of_the_run_itself_is_one_error(tmp_path: Path) -> None:
    config = short_config(**{"train.record": True, "train.decisions": 200})
    trainer(config, tmp_path).run()
    (tmp_path / EPISODES).write_bytes(b"x" * 100)
    saved = checkpoint.read(tmp_path / checkpoint.LAST)
    with pytest.raises(CheckpointError, match="damaged"):
        trainer(config, tmp_path).restore(saved)
