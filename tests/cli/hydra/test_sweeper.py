"""The search: its samples and objective, which trials count, and that a stop changes nothing."""

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import optuna
import pytest
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf
from sqlalchemy.exc import SQLAlchemyError

from flipperctl.cli.hydra import sweeps
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.hydra.sweeps import launched_by
from flipperctl.errors import ConfigError, FlipperctlError, InterruptedRunError, NonFiniteError
from flipperctl.training import search as searching
from flipperctl.training.search import SearchSettings, distributions, objective
from tests.cli.call import refused

DRAWN = ["agent.learning_rate=tag(log,interval(1e-4,3e-3))", "agent.batch_size=32,64"]


class Launcher:
    """Stands for Hydra's: a training whose success is its learning rate."""

    def __init__(self, fails: dict[int, BaseException] | None = None) -> None:
        self.fails = fails or {}
        self.jobs: list[dict[str, str]] = []

    def launch(self, jobs: list[list[str]], initial_job_idx: int) -> list[JobReturn]:
        return [self.train(job, initial_job_idx + i) for i, job in enumerate(jobs)]

    def train(self, job: list[str], number: int) -> JobReturn:
        error = self.fails.get(number)
        if error is not None and not isinstance(error, Exception):
            raise error  # as if the process had been killed
        drawn = dict(override.split("=") for override in job)
        self.jobs.append(drawn)
        done = JobReturn(status=JobStatus.FAILED if error else JobStatus.COMPLETED)
        done.return_value = error or float(drawn["agent.learning_rate"])
        done.hydra_cfg = OmegaConf.create({"hydra": {"runtime": {"output_dir": f"run{number}"}}})
        return done


def search(
    folder: Path,
    overrides: list[str] = DRAWN,
    fails: dict[int, Any] | None = None,
    own: str = ".",
    **settings: Any,
) -> tuple[list[dict[str, str]], list[optuna.trial.FrozenTrial]]:
    """The jobs of this start, and all trials of the study."""
    storage = f"sqlite:///{folder}/search.db"
    launcher = Launcher(fails)
    sweep = {"dir": str(folder / own), "subdir": "${hydra.job.num}"}
    jobs = launched_by(launcher, OmegaConf.create({"hydra": {"sweep": sweep}}))
    chosen = SearchSettings(storage=storage, **settings)
    sampled, fixed = Overrides.parse(overrides, check=False).sampled()
    searching.search(chosen, jobs, overrides, sampled, fixed, tell=print)
    return launcher.jobs, trials(folder)


def trials(folder: Path) -> list[optuna.trial.FrozenTrial]:
    return optuna.load_study(study_name="search", storage=f"sqlite:///{folder}/search.db").trials


def drawn(found: list[optuna.trial.FrozenTrial]) -> list[dict[str, Any]]:
    return [trial.params for trial in found if trial.value is not None]


def test_a_search_that_was_killed_finds_what_an_uninterrupted_one_finds(tmp_path: Path) -> None:
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
    _, whole = search(tmp_path / "whole", n_trials=12)
    with pytest.raises(KeyboardInterrupt):
        search(tmp_path / "killed", fails={11: KeyboardInterrupt()}, n_trials=12)
    jobs, killed = search(tmp_path / "killed", n_trials=12)
    assert len(jobs) == 1  # eleven were finished and count
    assert drawn(killed) == drawn(whole)  # tpe learns from the tenth trial on
    assert search(tmp_path / "killed", n_trials=12)[0] == []


SCRIPT = """
import sys, time
from pathlib import Path
from flipperctl import plugins
plugins.load()
from tests.cli.hydra.test_sweeper import Launcher, search
train = Launcher.train
def slow(self, job, number):
    time.sleep(float(sys.argv[2]))
    return train(self, job, number)
Launcher.train = slow
search(Path(sys.argv[1]), n_trials=8, n_jobs=int(sys.argv[3]), own=sys.argv[4])
"""


def start(folder: Path, pause: float, jobs: int, own: str) -> subprocess.Popen[bytes]:
    """Start a search in another process, whose trainings last ``pause`` [s]."""
    arguments = [str(folder), str(pause), str(jobs), own]
    with (folder / f"{own}.log").open("w") as log:
        return subprocess.Popen([sys.executable, "-c", SCRIPT, *arguments], stderr=log)


@pytest.mark.long
def test_two_searches_share_a_study_from_its_creation_on(tmp_path: Path) -> None:
    pair = {own: start(tmp_path, 0.1, jobs, own) for own, jobs in (("one", 1), ("two", 2))}
    for own, process in pair.items():
        assert process.wait(timeout=120) == 0, (tmp_path / f"{own}.log").read_text()
    found = trials(tmp_path)
    complete = [trial for trial in found if trial.state.name == "COMPLETE"]
    assert len(complete) == 8  # none twice, and none beyond the eight
    assert len({trial.params["agent.learning_rate"] for trial in complete}) == 8
    assert all(not trial.params for trial in found if trial not in complete)


@pytest.mark.long
def test_a_trial_that_runs_elsewhere_is_left_alone_until_its_process_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = start(tmp_path, 600, 1, "other")
    while not (running := [t for t in find_trials(tmp_path) if t.params.get("agent.batch_size")]):
        assert other.poll() is None
        time.sleep(0.1)
    train, states = Launcher.train, []

    def killing(self: Launcher, job: list[str], number: int) -> JobReturn:
        states.append(trials(tmp_path)[0].state.name)
        if number == 1:
            other.kill()
            other.wait()
        return train(self, job, number)

    monkeypatch.setattr(Launcher, "train", killing)
    jobs, found = search(tmp_path, n_trials=2)
    assert states == ["RUNNING", "FAIL"]
    assert len(jobs) == 2
    assert [trial.state.name for trial in found] == ["FAIL", "COMPLETE", "COMPLETE"]
    assert found[1].params != running[0].params == found[2].params  # sampled again


def find_trials(folder: Path) -> list[optuna.trial.FrozenTrial]:
    """The trials so far, none before the study exists."""
    try:
        return trials(folder)
    except (KeyError, SQLAlchemyError):
        return []


def test_more_trials_go_on_and_the_best_is_written(tmp_path: Path) -> None:
    search(tmp_path, n_trials=2)
    jobs, found = search(tmp_path, n_trials=5, n_jobs=2)
    assert (len(jobs), len(found)) == (3, 5)
    best = max(found, key=lambda trial: trial.params["agent.learning_rate"])
    written = OmegaConf.load(tmp_path / "optimization_results.yaml")
    assert written.best_params == best.params
    assert written.best_run == f"run{best.number}"


def test_equal_values_are_trained_once(tmp_path: Path) -> None:
    lists = ["agent.learning_rate=0.1,0.2"]
    jobs, found = search(tmp_path, lists, n_trials=6)
    assert len(jobs) == len({job["agent.learning_rate"] for job in jobs})
    assert [trial.value for trial in found] == [
        float(trial.params["agent.learning_rate"]) for trial in found
    ]
    assert len(found) == 6
    failing = {n: NonFiniteError("nan") for n in range(6)}
    (tmp_path / "fails").mkdir()
    with pytest.raises(FlipperctlError, match="every trial"):
        search(tmp_path / "fails", lists, failing, n_trials=6)
    assert len(trials(tmp_path / "fails")) == 6


def test_an_interrupted_trial_goes_on_in_its_own_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(KeyboardInterrupt):
        search(tmp_path, fails={2: KeyboardInterrupt()}, n_trials=4)
    numbers, train = [], Launcher.train

    def noted(self: Launcher, job: list[str], number: int) -> JobReturn:
        numbers.append(number)
        return train(self, job, number)

    monkeypatch.setattr(Launcher, "train", noted)
    _, found = search(tmp_path, n_trials=4)
    assert numbers == [2, 4]
    assert found[3].params == found[2].params


def test_a_wrong_request_stops_the_search_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"agent\.gamma"):
        search(tmp_path, fails={1: ConfigError("agent.gamma: …")}, n_trials=3)
    with pytest.raises(InterruptedRunError, match="1 of 3 trials are finished"):
        search(tmp_path, fails={1: InterruptedRunError("…")}, n_trials=3)


def test_one_study_holds_one_search_by_one_measure(tmp_path: Path) -> None:
    search(tmp_path, n_trials=1)
    with pytest.raises(ConfigError, match="another study_name"):
        search(tmp_path, [*DRAWN, "seed=2"], n_trials=1)
    storage = f"sqlite:///{tmp_path / 'search.db'}"
    optuna.load_study(study_name="search", storage=storage).set_user_attr("measure", None)
    with pytest.raises(ConfigError, match=r"θ̂_R at decisions.*another study_name"):
        search(tmp_path, n_trials=2)


def test_intervals_and_lists_are_drawn_and_the_rest_is_fixed() -> None:
    interval = ["agent.gamma=interval(0.9,0.99)", "agent.batch_size=int(interval(32,64))"]
    words = [*interval, "network=mlp,at_d3qn", "seed=3", "~rewards.pitch"]
    sampled, fixed = Overrides.parse(words).sampled()
    assert fixed == ["seed=3", "~rewards.pitch"]
    assert distributions(sampled) == {
        "agent.gamma": optuna.distributions.FloatDistribution(0.9, 0.99),
        "agent.batch_size": optuna.distributions.IntDistribution(32, 64),
        "network": optuna.distributions.CategoricalDistribution(["mlp", "at_d3qn"]),
    }
    with pytest.raises(ConfigError, match="nothing to search"):
        distributions({})


def test_the_objective_orders_by_success_and_then_by_swing_at_100_hz() -> None:
    def value(success: float, swing: float, at_decisions: float = 0.0) -> float:
        best = {
            "success_rate": success,
            "pitch_variation": at_decisions,
            "pitch_variation_100hz": swing,
        }
        found = objective(best, 40)
        assert found is not None
        return found

    assert value(1.0, 1.0) == pytest.approx(1 - 0.5 / 40)
    assert value(1.0, 0.0) == 1
    assert value(1.0, 0.5) > value(1.0, 1.0) > value(39 / 40, 0.0) > value(38 / 40, 0.0)
    assert value(1 / 40, 1e6) > value(0.0, 0.0)
    assert value(1.0, 1.0, at_decisions=0.9) == value(1.0, 1.0, at_decisions=0.1)
    assert objective(None, 40) is None


def test_the_objective_is_the_return_where_runs_choose_by_it() -> None:
    best = {"success_rate": 1.0, "pitch_variation_100hz": 0.5, "mean_return": 7.0}
    assert objective(best, 40, "return") == 7.0
    assert objective(best, 40, "last") == objective(best, 40) == objective(best, 40, "success")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["train.best_by=success,return"], "train.best_by: a search has one objective"),
        (
            ["rewards=smooth", "rewards.swing.weight=interval(2,16)", "train.best_by=return"],
            "rewards.swing.weight: a search by returns",
        ),
        (
            ["+reward@rewards.more=progress,impact", "train.best_by=return"],
            r"\+reward@rewards.more: a search by returns",
        ),
        (["experiment=quick,searched"], "experiment=searched: a search has one objective"),
        (["++train.validation_seed=interval(1,9)"], "train.validation_seed: a search has one"),
    ],
)
def test_objectives_that_do_not_compare_are_refused(words: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        sweeps.check_objective(*Overrides.parse(words, check=False).sampled())


def test_objectives_that_compare_are_searched() -> None:
    for words in (
        ["network=mlp,dueling_mlp", "network.hidden=[16],[32]"],  # they need each other
        ["rewards.swing.weight=interval(2,16)", "train.best_by=success"],
    ):
        sweeps.check_objective(*Overrides.parse(words, check=False).sampled())


def test_the_command_refuses_them(tmp_path: Path) -> None:
    """Within the application of Hydra, which composes otherwise than a test does."""
    words = ("rewards.swing.weight=0.1,1", "train.best_by=return")
    error = refused("train", "-m", "hydra/sweeper=optuna", *words, cwd=tmp_path)
    assert "rewards.swing.weight: a search by returns" in error


def test_values_have_the_types_that_hydra_gives_them() -> None:
    given = ["train.decisions=500", "device='cuda:0'", "batch_sizes=[1,2]", "x=1e-3", "y=null"]
    assert Overrides.parse(given).values() == {
        "train.decisions": 500,
        "device": "cuda:0",
        "batch_sizes": [1, 2],
        "x": 1e-3,
        "y": None,
    }


@pytest.mark.parametrize(
    "override", ["seed=1,2", "+seed=1", "++seed=1", "~seed", "x=interval(0,1)"]
)
def test_only_plain_values_are_allowed(override: str) -> None:
    with pytest.raises(ConfigError, match="one value is allowed here"):
        Overrides.parse([override]).values()
