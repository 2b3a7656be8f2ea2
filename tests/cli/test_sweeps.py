"""Sweeps beyond one process: each launcher trains with a plugin file, where the basic one would."""

import shutil
import sys
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins

from flipperctl import checkpoint
from tests.cli.call import EXACT, Done, call

pytestmark = pytest.mark.slow

QUICK = [
    f"{key}={value}"
    for key, value in {**EXACT, "train.decisions": 60, "agent.learning_starts": 30}.items()
]
LAUNCHERS = {
    "joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
    "slurm": ["hydra/launcher=submitit_local"],  # what SLURM's launcher does, on this machine
}
RAY = ["hydra/launcher=ray", "hydra.launcher.ray.init.address=local"]
ONE_CPU = [f"+hydra.launcher.ray.init.{s}" for s in ("include_dashboard=false", "num_cpus=1")]
SEARCH = ["hydra/sweeper=optuna", "hydra.sweeper.storage=sqlite:///search.db"]
RATE = "agent.learning_rate=tag(log,interval(1e-4,3e-3))"

FLOOR = '''
from typing import ClassVar

import numpy as np
from flipperctl.api import Profile, Terrain, terrain
from flipperctl.errors import NonFiniteError

@terrain("floor")
class Floor(Terrain):
    """A floor, or an error; not at the first draw, which the command makes before any job."""
    broken: bool = False
    drawn: ClassVar[int] = 0

    def generate(self, rng: np.random.Generator) -> Profile:
        Floor.drawn += self.broken
        if Floor.drawn > 3:  # those of the trial before a training pass
            raise NonFiniteError("the floor is broken")
        return Profile([(0, 0), (0.1, 0)])
'''


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a plugin file."""
    (tmp_path / "floor.py").write_text(FLOOR)
    return tmp_path


def sweep(folder: Path, *arguments: str) -> Done:
    return call("train", "-m", *QUICK, "--plugins", "floor.py", *arguments, cwd=folder)


def runs(folder: Path) -> set[str]:
    """The runs of the one sweep in ``folder`` that trained to their end."""
    return {best.parents[1].name for best in folder.glob(f"runs/multirun/*/*/{checkpoint.BEST}")}


@pytest.mark.long
@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_each_combination_is_trained_where_the_basic_launcher_would(
    folder: Path, launcher: str
) -> None:
    words = ["terrain=floor", "seed=1,2", "hydra.sweep.dir=runs/multirun/one"]
    first, second = (folder / f"runs/multirun/one/{n}" for n in ("0_seed=1", "1_seed=2"))
    assert sweep(folder, *words).code == 0
    before, weights = (path.joinpath(checkpoint.LAST) for path in (first, second))
    begun, own = before.stat().st_mtime_ns, weights.read_bytes()
    shutil.rmtree(second)
    done = sweep(folder, *words, *LAUNCHERS[launcher])  # goes on, in the processes of the launcher
    assert done.code == 0, done.err
    assert runs(folder) == {"0_seed=1", "1_seed=2"}
    assert before.stat().st_mtime_ns == begun
    assert weights.read_bytes() == own


@pytest.mark.long
def test_ray_does_so_too_and_an_error_in_a_job_is_the_commands(folder: Path) -> None:
    done = sweep(folder, "terrain=floor", "terrain.broken=false,true", *RAY, *ONE_CPU)
    assert done.code == 1
    (error,) = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert "terrain 'floor': generate raised NonFiniteError: the floor is broken" in error
    assert "Traceback" not in done.err
    assert "Error executing job" not in done.err
    assert runs(folder) == {"0_terrain.broken=False"}
    assert not sys.modules["ray"].is_initialized()


def test_a_launcher_that_is_not_installed_names_its_extra(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Plugins.instance()  # has read the installed launchers once and for all
    extras = {"joblib": "joblib", "submitit_slurm": "slurm"}
    for launcher, extra in extras.items():
        installed = ConfigStore.instance().repo["hydra"]["launcher"]
        monkeypatch.delitem(installed, f"{launcher}.yaml", raising=False)
        done = sweep(folder, "terrain=floor", f"hydra/launcher={launcher}")
        assert done.code == 2
        assert f"pip install 'flipperctl[{extra}]'" in done.err
        assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["hydra.sweeper.n_trials=0"], ["hydra.sweeper.n_trials", "≥ 1"]),
        (["hydra.sweeper.storage=sqlite:///no/x.db"], ["hydra.sweeper.storage", "no/x.db"]),
        (["rewards=paper", "agent.gamma=interval(0.9,1.5)"], ["agent.gamma", "1.5"]),
    ],
)
def test_a_wrong_search_is_refused_before_it_starts(
    wrong: list[str], words: list[str], folder: Path
) -> None:
    done = sweep(folder, "terrain=floor", *SEARCH, RATE, *wrong)
    assert (done.code, len(done.err.splitlines())) == (2, 1), done.err
    assert all(word in done.err for word in words)
    assert not (folder / "runs").exists()
