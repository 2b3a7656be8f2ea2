"""Hydra's options and settings of ``flipperctl train``, and its files of configuration."""

import contextlib
from datetime import datetime, tzinfo
from pathlib import Path

import pytest
import yaml
from hydra.core import utils

from flipperctl import train
from flipperctl.checkpoint.results import hold
from flipperctl.errors import OutputError
from tests.cli.call import EXACT, call, refused

QUICK = [
    *(f"{key}={value}" for key, value in EXACT.items()),
    *("terrain=flat", "train.decisions=40", "train.validation_episodes=1"),
]
QUICK = list({word.partition("=")[0]: word for word in QUICK}.values())


@pytest.fixture
def my(tmp_path: Path) -> Path:
    """A folder with an experiment."""
    file = tmp_path / "my" / "experiment" / "mine.yaml"
    file.parent.mkdir(parents=True)
    file.write_text("# @package _global_\nagent:\n  batch_size: 64\n  learning_rate: 1e-4\n")
    return file


def test_the_folder_of_a_run_and_of_a_sweep_is_the_output(tmp_path: Path) -> None:
    one = call("train", *QUICK, "--output", "my runs/one", cwd=tmp_path)
    assert one.code == 0, one.err
    assert "eval 'my runs/one'" in one.err
    several = call("train", *QUICK, "-m", "--output", "swept", "seed=1,2", cwd=tmp_path)
    assert several.code == 0, several.err
    assert (tmp_path / "swept" / "0_seed=1" / "config.yaml").is_file()


def test_files_of_configuration_are_read_by_hydra(tmp_path: Path, my: Path) -> None:
    words = [*QUICK, "--config-dir", "my", "experiment=mine", "--output", "run"]
    done = call("train", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    agent = yaml.safe_load((tmp_path / "run" / "config.yaml").read_text())["agent"]
    assert (agent["batch_size"], agent["learning_rate"]) == (64, 0.0001)
    my.write_text(my.read_text() + "  batch_size: 32\n")
    error = refused("train", *words, cwd=tmp_path)
    assert "found duplicate key batch_size" in error
    assert 'mine.yaml", line 5' in error


def test_paths_start_in_the_folder_of_the_command(tmp_path: Path, my: Path) -> None:
    (tmp_path / "g.csv").write_text("x,z\n0,0\n0.5,0\n0.5,0.05\n1,0.05\n")
    words = [w for w in QUICK if not w.startswith("terrain")]
    words += ["terrain=profile_file", "terrain.path=g.csv", "hydra.job.chdir=true"]
    words += ["hydra.run.dir=run", "hydra.searchpath=[my]", "experiment=mine"]
    here = Path.cwd()
    done = call("train", *words, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "hydra.job.chdir=true: the run stays in" in done.err
    assert "flipperctl eval run\n" in done.err
    assert Path.cwd() == here


@pytest.mark.long
def test_a_default_folder_that_is_taken_gives_way_to_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Jobs of an array and loops with & begin in the same second."""

    class Noon(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:
            return cls(2026, 1, 1, 12)

    monkeypatch.setattr(utils, "datetime", Noon)
    runs = tmp_path / "runs" / "flat"
    taken = runs / "2026-01-01_12-00-00"
    taken.mkdir(parents=True)
    with hold(taken):
        done = call("train", *QUICK, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "--checkpoint runs/flat/2026-01-01_12-00-00_2\n" in done.err
    record = (runs / f"{taken.name}_2" / ".hydra" / "hydra.yaml").read_text()
    assert f"output_dir: {runs / taken.name}_2\n" in record
    (taken / "config.yaml").write_text("mine")  # now a run in it, too
    (runs / f"{taken.name}_2").rename(runs / f"{taken.name}_3")
    assert flipperctl_train(tmp_path).name == f"{taken.name}_2"
    chosen = [*QUICK, f"hydra.run.dir={taken}"]
    assert "already holds a run" in refused("train", *chosen, cwd=tmp_path)
    with pytest.raises(OutputError, match="already holds a run"):
        train(overrides=chosen, progress=False)


def flipperctl_train(folder: Path) -> Path:
    """The run directory of a training by the Python interface."""
    with contextlib.chdir(folder):
        return train(overrides=QUICK, progress=False).directory
