"""The search: its samples and objective, which trials count, and that a stop changes nothing."""

from pathlib import Path
from typing import Any

import optuna
import pytest
from hydra.core.utils import JobReturn, JobStatus
from omegaconf import OmegaConf

from flipperctl.cli.hydra import sweeps
from flipperctl.cli.hydra.sweeps import launched_by
from flipperctl.errors import ConfigError, FlipperctlError, InterruptedRunError, NonFiniteError
from flipperctl.requests.request import Requests
from flipperctl.requests.text import from_words, read
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
    folder: Path, overrides: list[str] = DRAWN, fails: dict[int, Any] | None = None, **settings: Any
) -> tuple[list[dict[str, str]], list[optuna.trial.FrozenTrial]]:
    """The jobs of this start, and all trials of the study."""
    folder.mkdir(exist_ok=True)
    storage = f"sqlite:///{folder}/search.db"
    launcher = Launcher(fails)
    sweep = {"dir": str(folder), "subdir": "${hydra.job.num}"}
    jobs = launched_by(launcher, OmegaConf.create({"hydra": {"sweep": sweep}}))
    chosen = SearchSettings(storage=storage, **settings)
    sampled, fixed = sweeps.sampled(Requests(tuple(read(overrides))))
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


def test_more_trials_go_on_and_the_best_is_written(tmp_path: Path) -> None:
    search(tmp_path, n_trials=2)
    jobs, found = search(tmp_path, n_trials=5, n_jobs=2)
    assert (len(jobs), len(found)) == (3, 5)
    best = max(found, key=lambda trial: trial.params["agent.learning_rate"])
    written = OmegaConf.load(tmp_path / "optimization_results.yaml")
    assert written.best_params == best.params
    assert written.best_run == f"run{best.number}"


def test_trials_that_fail_count_and_no_other_is_proposed_in_their_place(tmp_path: Path) -> None:
    failing = {n: NonFiniteError("nan") for n in range(3)}
    with pytest.raises(FlipperctlError, match="every trial"):
        search(tmp_path, fails=failing, n_trials=3)
    jobs, found = search(tmp_path, n_trials=4)
    assert (len(jobs), len(found)) == (1, 4)
    assert len({trial.params["agent.learning_rate"] for trial in found}) == 4


@pytest.mark.parametrize("jobs", [1, 2])
def test_interrupted_trials_go_on_in_their_own_runs(
    jobs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers, train = [], Launcher.train

    def noted(self: Launcher, job: list[str], number: int) -> JobReturn:
        numbers.append(number)
        return train(self, job, number)

    with pytest.raises(KeyboardInterrupt):
        search(tmp_path, fails={3: KeyboardInterrupt()}, n_trials=6, n_jobs=jobs)
    left = [trial for trial in trials(tmp_path) if trial.value is None]
    monkeypatch.setattr(Launcher, "train", noted)
    search(tmp_path, n_trials=6, n_jobs=jobs)
    assert numbers == [3, 4, 5] if jobs == 1 else [2, 3, 4, 5]
    _, whole = search(tmp_path / "whole", n_trials=6, n_jobs=jobs)
    assert drawn(trials(tmp_path)) == drawn(whole)
    assert [trials(tmp_path)[t.number].params for t in left] == [t.params for t in left]


def test_a_trial_that_a_kill_left_without_its_values_is_proposed_anew(tmp_path: Path) -> None:
    search(tmp_path, n_trials=2)
    storage = f"sqlite:///{tmp_path / 'search.db'}"
    optuna.load_study(study_name="search", storage=storage).ask()  # and no value of it
    jobs, found = search(tmp_path, n_trials=3)
    assert (len(jobs), [trial.number for trial in found if trial.params]) == (1, [0, 1, 3])
    _, whole = search(tmp_path / "whole", n_trials=3)
    assert drawn(found) == drawn(whole)


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
    with pytest.raises(ConfigError, match=r"by None, not by pitch.*another study_name"):
        search(tmp_path, n_trials=2)


def test_intervals_and_lists_are_drawn_and_the_rest_is_fixed() -> None:
    interval = ["agent.gamma=interval(0.9,0.99)", "agent.batch_size=int(interval(32,64))"]
    words = [*interval, "network=mlp,at_d3qn", "seed=3", "~rewards.pitch"]
    sampled, fixed = sweeps.sampled(from_words(words))
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
            "pitch_variation_decisions": at_decisions,
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
    ],
)
def test_objectives_that_do_not_compare_are_refused(words: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        sweeps.check_objective(*sweeps.sampled(Requests(tuple(read(words)))))


def test_objectives_that_compare_are_searched() -> None:
    for words in (
        ["network=mlp,dueling_mlp", "network.hidden=[16],[32]"],  # they need each other
        ["rewards.swing.weight=interval(2,16)", "train.best_by=success"],
    ):
        sweeps.check_objective(*sweeps.sampled(Requests(tuple(read(words)))))


def test_the_command_refuses_them(tmp_path: Path) -> None:
    """Within the application of Hydra, which composes otherwise than a test does."""
    words = ("rewards.swing.weight=0.1,1", "train.best_by=return")
    error = refused("train", "-m", "hydra/sweeper=optuna", *words, cwd=tmp_path)
    assert "rewards.swing.weight: a search by returns" in error


@pytest.mark.parametrize(
    "override", ["seed=1,2", "+seed=1", "++seed=1", "~seed", "x=interval(0,1)"]
)
def test_only_plain_values_are_allowed(override: str) -> None:
    with pytest.raises(ConfigError, match="one value is allowed here"):
        from_words([override]).values()
