"""A training that is refused leaves nothing that would refuse the corrected command."""

from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.errors import ConfigError
from flipperctl.training.trainer import Trainer
from tests.cli.call import EXACT, call

QUICK = [f"{key}={value}" for key, value in {**EXACT, "train.decisions": 40}.items()]
RUN = ["train", "terrain=step", *QUICK, "hydra.run.dir=run"]
OVER_RAY = [word for word in RUN if word != "train.mode=exact"]


@pytest.mark.slow
def test_the_corrected_command_trains_where_the_wrong_one_was_refused(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    wrong = ["collector=ray", "collector.address=127.0.0.1:1"]
    done = call(*OVER_RAY, *wrong, cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    assert "collector.address: no Ray cluster answers at '127.0.0.1:1'" in done.err
    assert list(tmp_path.iterdir()) == []
    done = call(*RUN, cwd=tmp_path)
    assert done.code == 0, done.err
    assert (tmp_path / "run" / checkpoint.BEST).is_file()


def test_what_is_refused_before_its_first_decision_keeps_only_what_others_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a teacher's file that is removed between the check of the request and the run."""

    def vanished(*given: object) -> None:
        raise ConfigError("teacher.episodes: gone")

    monkeypatch.setattr("flipperctl.training.trainer.add_recorded", vanished)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    assert call(*RUN, cwd=tmp_path).code == 2
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_what_fails_after_a_decision_keeps_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(self: Trainer, collector: object) -> bool:
        raise ConfigError("refused in the middle")

    monkeypatch.setattr(Trainer, "_validate", refused)
    done = call(*RUN, cwd=tmp_path)
    assert done.code == 2, done.err
    assert (tmp_path / "run" / checkpoint.LAST).is_file()
