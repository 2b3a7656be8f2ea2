"""Episodes are those of one policy, though its file is replaced while it is evaluated."""

from pathlib import Path

import pytest

from flipperctl.checkpoint import shipped_policies
from flipperctl.evaluation.rows import Row
from flipperctl.evaluation.store import FolderStore
from flipperctl.evaluation.workers import EpisodeRunner
from flipperctl.policies.source import PolicySource
from tests.evaluation.test_store import LEVEL, config, evaluate


def test_a_policy_that_is_replaced_meanwhile_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a run that is still trained and finds a better policy."""
    shipped, file = shipped_policies(), tmp_path / "best.safetensors"
    file.write_bytes(shipped["mpc_value"].read_bytes())
    play = EpisodeRunner.play

    def replaced(self: EpisodeRunner, index: int) -> Row:
        if index == 3:
            file.write_bytes(shipped["generalist"].read_bytes())
        return play(self, index)

    monkeypatch.setattr(EpisodeRunner, "play", replaced)
    learner = PolicySource(checkpoint=file)
    scenes = [(config(5), learner), (config(5, seed=5), learner), (config(5), LEVEL)]
    found = evaluate(scenes, store=FolderStore(tmp_path / "cells"))
    assert [(one.entry.label, len(one.episodes)) for one in found.rows] == [("level", 5)]
    assert len(found.failures) == 2
    assert all("has changed since the evaluation began" in str(f.error) for f in found.failures)
    names = [file.name for file in (tmp_path / "cells").iterdir()]
    stored = [n for n in names if ".x." not in n and "failed" not in n]
    assert [name.split(".")[5] for name in stored] == ["000000-000001"]
