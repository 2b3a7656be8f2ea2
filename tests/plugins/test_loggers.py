"""What ``wandb`` records, through a tracker that remembers its calls; what TensorBoard shows."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from flipperctl_plugins.loggers.tensorboard import Events
from flipperctl_plugins.loggers.wandb import Tracker
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from flipperctl.api import Logger, RunInfo, registry

Begin = Callable[[str], Any]


class Remembering:
    """A run of a tracker; ``log`` and ``finish`` may fail or wait."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.ids: list[str] = []
        self.values: list[tuple[int, dict[str, float]]] = []
        self.error = error
        self.go_on = threading.Event()
        self.go_on.set()

    def begin(self, run_id: str) -> "Remembering":
        self.ids.append(run_id)
        return self

    def log(self, values: dict[str, float], step: int) -> None:
        if self.error is not None:
            raise self.error
        self.values.append((step, values))

    def finish(self) -> None:
        self.go_on.wait()


@pytest.fixture
def slow() -> Iterator[Remembering]:
    found = Remembering()
    found.go_on.clear()
    yield found
    found.go_on.set()


def run(folder: Path, resume_at: int | None = None) -> RunInfo:
    return RunInfo(folder, folder / "tracker", {"seed": 1}, resume_at)


def row(decision: int) -> dict[str, Any]:
    return {"decision": decision, "episode": 1, "terrain": "flat", "loss": None, "return": 2.5}


def test_values_have_tensorboard_s_names_and_a_resumed_run_goes_on_in_the_same_one(
    tmp_path: Path,
) -> None:
    kept = Remembering()
    for resume_at, decisions in ((None, (20, 40)), (20, (40, 60))):
        tracker = Tracker(kept.begin, run(tmp_path, resume_at), patience=10)
        for decision in decisions:
            tracker.episode(row(decision))
        tracker.validation(row(decisions[-1]))
        tracker.close()
    assert len(set(kept.ids)) == 1
    # Decision 40 was tracked before the run was stopped, and is the same when it is repeated.
    assert [step for step, _ in kept.values] == [20, 40, 40, 60, 60]
    assert [values for _, values in kept.values[1:3]] == [
        {"episode/return": 2.5},
        {"validation/return": 2.5},
    ]
    Tracker(kept.begin, run(tmp_path), patience=10).close()
    assert len(set(kept.ids)) == 2  # a new run in the same folder


def test_a_tracker_that_does_not_finish_is_left_behind(tmp_path: Path, slow: Remembering) -> None:
    tracker = Tracker(slow.begin, run(tmp_path), patience=0.01)
    with pytest.raises(TimeoutError, match=r"within 0\.01 s"):
        tracker.close()


@pytest.mark.parametrize("error", [ValueError("no server"), SystemExit(3)])
def test_what_fails_in_the_thread_is_raised_in_the_training(
    error: BaseException, tmp_path: Path
) -> None:
    tracker = Tracker(Remembering(error).begin, run(tmp_path), patience=10)
    tracker.episode(row(20))
    with pytest.raises((ValueError, RuntimeError), match=r"no server|SystemExit\(3\)"):
        tracker.close()


def test_a_package_that_is_missing_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flipperctl_plugins.loggers.wandb.find_spec", lambda package: None)
    cls = registry["logger", "wandb"]
    assert issubclass(cls, Logger)
    with pytest.raises(ImportError, match=r"pip install 'flipperctl\[wandb\]'"):
        cls().open(run(tmp_path))


def test_tensorboard_opens_on_success_return_and_pitch_variation(tmp_path: Path) -> None:
    """Viewers open the group that is first by name."""
    events = Events(tmp_path)
    events.episode(row(20))
    events.validation(row(40) | {"success_rate": 0.5, "pitch_variation_100hz": 1.25, "seconds": 3})
    events.close()
    found: Any = EventAccumulator(str(tmp_path))
    found.Reload()
    tags = sorted(found.Tags()["scalars"])
    first = ["pitch_variation_100hz", "return", "success_rate"]
    assert [tag for tag in tags if tag.startswith(tags[0].split("/")[0])] == [
        f"at_a_glance/{name}" for name in first
    ]
    assert [(point.step, point.value) for point in found.Scalars(tags[0])] == [(40, 1.25)]
    assert {"episode/return", "validation/return", "validation/seconds"} <= set(tags)
