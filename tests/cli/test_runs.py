"""Run directories: held by one process, and resumed from all that a kill can leave."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.cli.hydra.sweeps import UNNAMED
from flipperctl.results import hold
from flipperctl.training import folder as run_folder
from flipperctl.training import sweep
from flipperctl.training.sweep import folder_name
from flipperctl.training.trainer import Trainer
from tests.cli.call import EXACT, call
from tests.long.forked import differences, result

pytestmark = pytest.mark.slow

SHORT = {**EXACT, "train.decisions": 200, "train.validate_every": 90}
QUICK = ["terrain=step", *(f"{key}={value}" for key, value in SHORT.items())]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted run; its folder's name needs quotes."""
    folder = tmp_path_factory.mktemp("whole")
    done = call("train", *QUICK, "hydra.run.dir='a run'", cwd=folder)
    assert done.code == 0, done.err
    assert "flipperctl eval --checkpoint 'a run'\n" in done.err
    return folder / "a run"


def files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("command", ["start", "resume"])
def test_a_run_that_is_being_trained_is_left_alone(
    command: str, whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    with hold(run):
        before = files(run)
        arguments = {
            "start": ["hydra.run.dir=run", *QUICK],
            "resume": ["--resume", "run", "train.decisions=400"],
        }[command]
        done = call("train", *arguments, cwd=tmp_path)
        assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
        assert "run is being trained by process" in done.err
        assert files(run) == before


def _nothing(run: Path) -> None:
    """Killed after config.yaml."""
    for name in ("best", "last"):
        (run / f"checkpoints/{name}.safetensors").unlink()
    (run / "checkpoints/.last.safetensors.123-0123abcd.part").write_bytes(b"half")


def _no_summary(run: Path) -> None:
    """Killed after the last checkpoint."""


def _half_a_row(run: Path) -> None:
    with (run / "metrics.csv").open("a") as file:
        file.write("episode,2")


@pytest.mark.parametrize("leave", [_nothing, _no_summary, _half_a_row])
def test_a_run_goes_on_from_whatever_a_kill_leaves(
    leave: Callable[[Path], None], whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
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
    again = call("train", "--resume", "run", cwd=tmp_path)
    assert "nothing left to do" in again.err


@pytest.mark.parametrize("config", [True, False])
def test_a_run_whose_last_checkpoint_was_deleted_is_kept(
    config: bool, whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    (run / checkpoint.LAST).unlink()  # the largest file of a run
    if not config:
        (run / "config.yaml").unlink()
    before = files(run)
    done = call("train", "--resume", "run", "train.decisions=400", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "lacks checkpoints/last.safetensors, from which it would be resumed" in done.err
    assert files(run) == before


def test_a_run_that_started_from_another_needs_it_no_more(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(whole, tmp_path / "first")
    start = ["agent.start_from=first", "hydra.run.dir=run"]
    assert call("train", *QUICK, *start, cwd=tmp_path).code == 0
    _, config = run_folder.read(tmp_path / "run")
    stopped = tmp_path / "stopped"
    (stopped / "checkpoints").mkdir(parents=True)
    run_folder.write_config(stopped, config)
    monkeypatch.chdir(tmp_path)
    Trainer(config, stopped).run(stop=lambda: True)  # before its first decision
    shutil.rmtree(tmp_path / "first")
    done = call("train", "--resume", "stopped", cwd=tmp_path)
    assert done.code == 0, done.err
    assert differences(stopped, result(tmp_path / "run")) == []


def test_hydras_record_is_no_run(whole: Path, tmp_path: Path) -> None:
    record = tmp_path / "run" / ".hydra"
    record.mkdir(parents=True)
    shutil.copy(whole / "config.yaml", record)
    for folder in ("run", "run/.hydra"):
        done = call("train", "--resume", folder, cwd=tmp_path)
        assert (done.code, len(done.err.splitlines())) == (2, 1)
        assert "must be started again" in done.err


def test_damaged_metrics_are_named(whole: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    with (run / "metrics.csv").open("ab") as file:
        file.write(b"\xff")
    done = call("train", "--resume", "run", "train.decisions=400", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "run/metrics.csv is damaged" in done.err
    (run / "metrics.csv").unlink()
    assert call("train", "--resume", "run", "train.decisions=400", cwd=tmp_path).code == 0


def test_a_folder_without_a_run_is_started_anew(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("")  # and no checkpoint: nothing to lose
    done = call("train", "--resume", "run", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "must be started again" in done.err
    assert call("train", *QUICK, "hydra.run.dir=run", cwd=tmp_path).code == 0


def test_a_config_that_is_damaged_says_so(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.yaml").write_text("terrain: [")
    done = call("train", "--resume", "run", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "run/config.yaml is damaged" in done.err


def test_the_written_configuration_is_the_one_that_is_read(whole: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    saved, config = run_folder.read(run)
    assert saved is not None
    (run / checkpoint.LAST).unlink()
    assert run_folder.read(run) == (None, config)


def test_a_checkpoint_outside_of_a_run_is_no_run(whole: Path, tmp_path: Path) -> None:
    shutil.copy(whole / checkpoint.LAST, tmp_path / "mine.safetensors")
    done = call("train", "--resume", "mine.safetensors", cwd=tmp_path)
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "does not lie in a run directory" in done.err


def test_a_run_directory_that_is_deleted_is_one_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    validate = Trainer._validate

    def delete(self: Trainer, collector: Any) -> None:
        shutil.rmtree(self.directory)
        validate(self, collector)

    monkeypatch.setattr(Trainer, "_validate", delete)
    done = call("train", *QUICK, "hydra.run.dir=run", cwd=tmp_path)
    assert done.code == 1
    assert len(done.err.splitlines()) == 1
    assert "run was deleted or moved while the run was training" in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [["--version"], ["--help"], ["inspect", "config"], ["inspect", "config", "--json"]],
    ids=" ".join,
)
def test_an_output_that_is_full_is_one_clear_error(arguments: list[str]) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no device that is always full")
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "flipperctl", *arguments]
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=60
        )
    assert done.returncode == 1
    assert done.stderr == ("error: standard output cannot be written: No space left on device\n")


def test_folders_are_named_after_what_is_swept() -> None:
    assert folder_name(3, {"seed": "1", "terrain": "step"}) == "3_seed=1,terrain=step"
    assert (
        folder_name(0, {"agent.learning_rate": "0.00031234567"})
        == "0_agent.learning_rate=0.00031235"
    )
    odd = folder_name(12, {"terrain.path": "../a b/'c'.csv", "train.x": "[1,2]"})
    assert odd == "12_terrain.path=.._a_b_c_.csv,train.x=_1,2_"
    assert len(folder_name(1, {f"agent.key{i}": "value" for i in range(40)})) == 120


def test_the_name_that_gives_way_is_the_one_that_is_configured() -> None:
    configured = (Path(__file__).parents[2] / "configs" / "train.yaml").read_text()
    assert f"subdir: {UNNAMED}\n" in configured


def test_a_sweep_tells_of_runs_that_failed_and_keeps_a_folder_of_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweep, "_AT_ONCE", 0.0)  # the first fails at once
    (tmp_path / "0").mkdir()
    options = ["hydra.sweep.dir=.", "hydra.sweep.subdir=${hydra.job.num}"]
    shutil.copytree(tmp_path / "0", tmp_path / "copy")
    (tmp_path / "0" / "config.yaml").write_text("mine")
    done = call("train", "-m", *QUICK, "seed=1,2", *options, cwd=tmp_path)
    assert done.code == 2
    assert "Error executing job" not in done.err
    assert "run 1 of 2\n" in done.err
    assert re.search(r"run 2 of 2; about \d+ s left for all", done.err)
    assert done.err.splitlines()[-1].startswith("error: ")
    assert "0/config.yaml: its configuration does not fit" in done.err.splitlines()[-1]
    table = (tmp_path / "sweep.csv").read_text()
    assert "failed" in table
    assert "finished" in table
    assert json.loads((tmp_path / "1" / "summary.json").read_text())["finished"] is True
    assert (tmp_path / "0" / "config.yaml").read_text() == "mine"


def test_two_sweeps_do_not_share_a_folder(tmp_path: Path) -> None:
    with hold(tmp_path, "sweep"):
        before = files(tmp_path)
        done = call("train", "-m", *QUICK, "seed=1,2", "hydra.sweep.dir=.", cwd=tmp_path)
        assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
        assert files(tmp_path) == before


def test_a_policy_that_no_validation_chose_is_evaluated_with_a_word(
    whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    evaluate = ["eval", "--checkpoint", "run", "--episodes", "1", "--json"]
    assert "no validation" not in call(*evaluate, cwd=tmp_path).err
    (run / checkpoint.BEST).unlink()
    done = call(*evaluate, cwd=tmp_path)
    assert done.code == 0, done.err
    (line,) = (line for line in done.err.splitlines() if "validation" in line)
    assert line.startswith("run: no validation has chosen a best policy yet; this is the last one")
