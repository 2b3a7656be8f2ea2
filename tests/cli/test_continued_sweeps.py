"""A sweep that was stopped goes on where it stopped, when the same words are typed again."""

import csv
import json
import shlex
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.training.trainer import Trainer
from tests.cli.call import EXACT, Done, call
from tests.long.runs import differences, result

pytestmark = pytest.mark.slow

SHORT = {
    **EXACT,
    "train.decisions": 60,
    "train.validate_every": 30,
    "train.validation_episodes": 1,
    "agent.learning_starts": 40,
    "agent.batch_size": 16,
}
WORDS = [
    "terrain=step",
    "terrain.height=0.9",
    *(f"{key}={value}" for key, value in SHORT.items()),
    "seed=1,2,3",
]


def sweep(folder: Path, *more: str) -> Done:
    return call("train", "-m", *WORDS, *more, cwd=folder)


def states(folder: Path) -> list[tuple[str, str]]:
    with (folder / "sweep.csv").open(newline="") as file:
        return [(row["seed"], row["state"]) for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep that was not stopped."""
    folder = tmp_path_factory.mktemp("whole")
    done = sweep(folder, "hydra.sweep.dir=s w")
    assert done.code == 0, done.err
    table = done.err[done.err.index("3 runs") :]
    assert all(word in table for word in ("success", "0 %", "sweep.csv"))
    assert "In parentheses" not in table  # no run has a pitch variation
    assert "0_seed=1" not in table  # runs that differ in their seeds alone are one row
    with (folder / "s w" / "sweep.csv").open(newline="") as file:
        first, *_ = csv.DictReader(file)
    assert (first["run"], first["seed"], first["decisions"]) == ("0", "1", "60")
    best = json.loads((folder / "s w" / "0_seed=1" / "summary.json").read_text())["best"]
    assert (first["success_rate"], int(first["best_decision"])) == ("0.0", best["decision"])
    for name in ("pitch_variation_100hz", "pitch_variation_decisions", "t_cost"):
        assert first[name] == ""  # of those that reached the finish
    return folder / "s w"


@pytest.fixture
def interrupt_at(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A function that arranges signals in a run, at the end of its first episode."""

    def arrange(seed: int, *numbers: signal.Signals) -> None:
        train = Trainer._train_episode

        def signalled(self: Trainer, collector: object) -> None:
            train(self, collector)
            if self.config.seed == seed and self.progress.episode == 1:
                for number in numbers:
                    signal.raise_signal(number)

        monkeypatch.setattr(Trainer, "_train_episode", signalled)

    return arrange


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        pytest.param([signal.SIGTERM], [], marks=pytest.mark.long),
        ([signal.SIGINT, signal.SIGINT], ["hydra.sweep.dir=s w"]),
    ],
    ids=["SIGTERM", "two Ctrl-C"],
)
def test_the_printed_command_goes_on_to_the_same_results(
    numbers: list[signal.Signals],
    named: list[str],
    whole: Path,
    interrupt_at: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    interrupt_at(2, *numbers)
    done = sweep(tmp_path, *named)
    assert done.code == 130
    error = done.err.splitlines()[-1]
    assert error.startswith("error: interrupted; 1 of 3 runs are finished. Continue with: ")
    (folder,) = [path.parent for path in tmp_path.rglob("sweep.csv")]
    begun = [("1", "finished"), ("2", "interrupted")]
    killed = numbers.count(signal.SIGINT) > 1  # at once, in the middle of the launch
    assert states(folder) == (begun if killed else [*begun, ("3", "not begun")])
    monkeypatch.undo()

    first = (folder / "0_seed=1" / "summary.json").stat().st_mtime_ns
    program, *words = shlex.split(error.partition("Continue with: ")[2])
    assert program == "flipperctl"
    done = call(*words, cwd=tmp_path)
    assert done.code == 0, done.err
    (skipped,) = (line for line in done.err.splitlines() if line.endswith(" is finished"))
    assert "0_seed=1" in skipped
    assert (folder / "0_seed=1" / "summary.json").stat().st_mtime_ns == first
    assert states(folder) == [("1", "finished"), ("2", "finished"), ("3", "finished")]
    for name in ("0_seed=1", "1_seed=2", "2_seed=3"):
        assert differences(folder / name, result(whole / name)) == []


def test_a_run_without_a_checkpoint_begins_anew_and_one_at_its_end_is_closed(
    whole: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "s w"))
    for name in ("best", "last"):
        (folder / f"0_seed=1/checkpoints/{name}.safetensors").unlink()
    for name in ("0_seed=1", "1_seed=2"):
        (folder / name / "summary.json").unlink()
    shutil.rmtree(folder / "2_seed=3")
    done = sweep(tmp_path, "hydra.sweep.dir=s w")
    assert done.code == 0, done.err
    assert "0_seed=1 was stopped before its first checkpoint; it begins again" in done.err
    for name in ("0_seed=1", "1_seed=2", "2_seed=3"):
        assert differences(folder / name, result(whole / name)) == []


def test_a_run_with_other_settings_is_refused_by_name(whole: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "s w"))
    before = (folder / "0_seed=1" / checkpoint.LAST).read_bytes()
    (folder / "sweep.csv").write_text("job,folder,as it was\n")
    done = sweep(tmp_path, "hydra.sweep.dir=s w", "agent.gamma=0.9")
    assert done.code == 2
    error = done.err.splitlines()[-1]
    assert "0_seed=1 already holds a run with other settings" in error
    assert "agent.gamma: 0.99 there, 0.9 here" in error
    assert (folder / "0_seed=1" / checkpoint.LAST).read_bytes() == before
    assert (folder / "sweep.csv").read_text() == "job,folder,as it was\n"


def test_ctrl_c_before_the_first_run_begins_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "flipperctl.training.run.check_contract", lambda *_: signal.raise_signal(signal.SIGINT)
    )
    done = sweep(tmp_path, "hydra.sweep.dir=s")
    assert (done.code, done.err.splitlines()[-1]) == (130, "error: interrupted")
    assert list(tmp_path.iterdir()) == []
