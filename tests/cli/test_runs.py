"""Run directories: held by one process, refused, and resumed from all that a kill can leave."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.checkpoint.results import hold
from flipperctl.errors import ConfigError
from flipperctl.training import folder as run_folder
from flipperctl.training import sweep
from flipperctl.training.listeners import Companion
from flipperctl.training.sweep import folder_name
from flipperctl.training.trainer import Trainer
from tests.cli.call import EXACT, call, refused
from tests.long.runs import differences, result

pytestmark = pytest.mark.slow

SHORT = {**EXACT, "train.decisions": 100, "train.validate_every": 40, "agent.learning_starts": 50}
QUICK = ["terrain=step", *(f"{key}={value}" for key, value in SHORT.items())]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted run; its folder's name needs quotes."""
    folder = tmp_path_factory.mktemp("whole")
    done = call("train", *QUICK, "hydra.run.dir='a run'", cwd=folder)
    assert done.code == 0, done.err
    assert "flipperctl eval 'a run'\n" in done.err
    return folder / "a run"


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    """A copy of the run."""
    return Path(shutil.copytree(whole, tmp_path / "run"))


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_run_that_is_being_trained_is_left_alone(run: Path, tmp_path: Path) -> None:
    before = files(run)
    for words in (["hydra.run.dir=run", *QUICK], ["--resume", "run", "train.decisions=400"]):
        with hold(run):
            error = refused("train", *words, cwd=tmp_path)
        assert "run is being trained by another process" in error
    assert files(run) == before


def _nothing(run: Path) -> None:
    """Killed after config.yaml."""
    for name in ("best", "last"):
        (run / f"checkpoints/{name}.safetensors").unlink()
    (run / "checkpoints/.last.safetensors.123-0123abcd.part").write_bytes(b"half")


def _half_a_row(run: Path) -> None:
    with (run / "metrics.csv").open("a") as file:
        file.write("episode,2")


@pytest.mark.parametrize("leave", [_nothing, _half_a_row])
def test_a_run_goes_on_from_whatever_a_kill_leaves(
    leave: Callable[[Path], None], run: Path, whole: Path, tmp_path: Path
) -> None:
    (run / "summary.json").unlink()
    leave(run)
    begins = not (run / checkpoint.LAST).exists()
    anew = call("train", *QUICK, "hydra.run.dir=run", cwd=tmp_path)
    assert anew.code == 2
    assert "resume it with: flipperctl train --resume run, or" in anew.err
    done = call("train", "--resume", "run", cwd=tmp_path)
    assert done.code == 0, done.err
    assert ("it begins again" in done.err) == begins
    assert differences(run, result(whole)) == []
    assert list(run.rglob("*.part")) == []


def _damage(run: Path, name: str, text: bytes) -> None:
    (run / name).write_bytes((run / name).read_bytes() + text)


def _replace(run: Path, name: str, text: bytes, other: bytes) -> None:
    content = (run / name).read_bytes()
    assert text in content
    (run / name).write_bytes(content.replace(text, other))


@pytest.mark.parametrize(
    ("arrange", "resumed", "text"),
    [
        (lambda run: (run / checkpoint.LAST).unlink(), "run", "lacks checkpoints/last.safetensors"),
        (
            lambda run: _replace(run, "metrics.csv", b",", b";"),
            "run",
            "run/metrics.csv was changed within",
        ),
        (
            lambda run: _replace(run, "config.yaml", b"gamma: 0.99", b"gamma: 0.9"),
            "run",
            "agent.gamma: 0.9 in the file, 0.99 in the checkpoint; a run goes on with the config",
        ),
        (lambda run: _damage(run, "config.yaml", b"a: ["), "run", "run/config.yaml was edited: "),
        (
            lambda run: [shutil.rmtree(run / "checkpoints"), _damage(run, "config.yaml", b"a: [")],
            "run",
            "run/config.yaml is damaged",
        ),
    ],
)
def test_what_cannot_be_resumed_says_why_and_is_kept(
    arrange: Callable[[Path], object], resumed: str, text: str, run: Path, tmp_path: Path
) -> None:
    arrange(run)
    before = files(tmp_path)
    done = call("train", "--resume", resumed, "train.decisions=400", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert text in done.err
    assert files(tmp_path) == before


@pytest.mark.long
def test_a_run_that_started_from_another_needs_it_no_more(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(whole, tmp_path / "first")
    start = ["agent.start_from=first", "hydra.run.dir=run"]
    assert call("train", *QUICK, *start, cwd=tmp_path).code == 0
    _, config = run_folder.read(tmp_path / "run")
    stopped = tmp_path / "stopped"
    (stopped / "checkpoints").mkdir(parents=True)
    run_folder.write_config(stopped, config, Companion(stopped))
    monkeypatch.chdir(tmp_path)
    Trainer(config, stopped).run(stop=lambda: True)  # before its first decision
    shutil.rmtree(tmp_path / "first")
    done = call("train", "--resume", "stopped", cwd=tmp_path)
    assert done.code == 0, done.err
    assert differences(stopped, result(tmp_path / "run")) == []


def test_a_run_directory_that_is_deleted_is_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    validate = Trainer._validate

    def delete(self: Trainer, collector: Any) -> None:
        shutil.rmtree(self.directory)
        validate(self, collector)

    monkeypatch.setattr(Trainer, "_validate", delete)
    done = call("train", *QUICK, "hydra.run.dir=run", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (1, 1)
    assert "run was deleted or moved while the run was training" in done.err
    assert list(tmp_path.iterdir()) == []


def test_folders_are_named_after_what_is_swept() -> None:
    assert folder_name(3, {"seed": "1", "terrain": "step"}) == "3_seed=1,terrain=step"
    rate = folder_name(0, {"agent.learning_rate": "0.00031234567"})
    assert rate == "0_agent.learning_rate=0.00031235"
    odd = folder_name(12, {"terrain.path": "../a b/'c'.csv", "train.x": "[1,2]"})
    assert odd == "12_terrain.path=.._a_b_c_.csv,train.x=_1,2_"
    assert len(folder_name(1, {f"agent.key{i}": "value" for i in range(40)})) == 120


def test_a_sweep_tells_of_runs_that_failed_and_keeps_a_folder_of_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "_AT_ONCE", 0.0)  # the first fails at once
    (tmp_path / "0").mkdir()
    (tmp_path / "0" / "config.yaml").write_text("mine")
    options = ["hydra.sweep.dir=.", "hydra.sweep.subdir=${hydra.job.num}"]
    done = call("train", "-m", *QUICK, "seed=1,2", *options, cwd=tmp_path)
    assert done.code == 2
    assert "Error executing job" not in done.err
    assert "run 1 of 2\n" in done.err
    assert re.search(r"run 2 of 2; about \d+ s left for all", done.err)
    assert "0/config.yaml: its configuration does not fit" in done.err.splitlines()[-1]
    table = (tmp_path / "sweep.csv").read_text()
    assert all(state in table for state in ("failed", "finished"))
    assert json.loads((tmp_path / "1" / "summary.json").read_text())["finished"] is True
    assert (tmp_path / "0" / "config.yaml").read_text() == "mine"


def test_a_policy_that_no_validation_chose_is_evaluated_with_a_word(
    run: Path, tmp_path: Path
) -> None:
    evaluate = ["eval", "--checkpoint", "run", "--episodes", "1", "--json"]
    assert "no validation" not in call(*evaluate, cwd=tmp_path).err
    (run / checkpoint.BEST).unlink()
    done = call(*evaluate, cwd=tmp_path)
    assert done.code == 0, done.err
    (line,) = (line for line in done.err.splitlines() if "validation" in line)
    assert line.startswith("run: no validation has chosen a best policy yet; this is the last one")


RUN = ["train", *QUICK, "hydra.run.dir=run"]


def test_what_is_refused_before_its_first_decision_leaves_nothing_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a teacher's file that is removed between the check of the request and the run."""

    def vanished(*given: object) -> None:
        raise ConfigError("teacher.episodes: gone")

    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    with monkeypatch.context() as context:
        context.setattr("flipperctl.learners.d3qn_run.add_recorded", vanished)
        assert call(*RUN, cwd=tmp_path).code == 2
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["notes.txt"]
    done = call(*RUN, cwd=tmp_path)
    assert done.code == 0, done.err
    assert (tmp_path / "run" / checkpoint.BEST).is_file()


@pytest.mark.long
def test_a_cluster_that_does_not_answer_leaves_nothing(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    words = [word for word in RUN if word != "train.mode=exact"]
    done = call(*words, "collector=ray", "collector.address=127.0.0.1:1", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    assert "collector.address: no Ray cluster answers at '127.0.0.1:1'" in done.err
    assert list(tmp_path.iterdir()) == []


def test_what_fails_after_a_decision_keeps_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(self: Trainer, collector: object) -> bool:
        raise ConfigError("refused in the middle")

    monkeypatch.setattr(Trainer, "_validate", refused)
    done = call(*RUN, cwd=tmp_path)
    assert done.code == 2, done.err
    assert (tmp_path / "run" / checkpoint.LAST).is_file()


def test_a_film_shows_the_policy_of_each_validation(tmp_path: Path) -> None:
    from PIL import Image

    done = call("train", *QUICK, "hydra.run.dir=run", "--film", "progress.gif", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "wrote progress.gif" in done.err
    # Each validated policy is kept, and the best one among them is the run's.
    kept = [f.name for f in sorted((tmp_path / "run" / "checkpoints").glob("at_*"))]
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    best = tmp_path / "run" / checkpoint.KEPT.format(summary["best"]["decision"])
    assert best.read_bytes() == (tmp_path / "run" / checkpoint.BEST).read_bytes()
    assert len(kept) >= 3
    with Image.open(tmp_path / "progress.gif") as film:
        assert film.n_frames > len(kept) * 5
