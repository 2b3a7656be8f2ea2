"""The progress of a training, and its interruption."""

from pathlib import Path

import pytest

from flipperctl.terminal import progress
from tests.cli.call import call

ROW = {"loss": None, "success_rate": 0.0, "epsilon": 1.0}


def test_the_time_left_is_that_of_the_recent_rate_and_not_told_before_it_is_known(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a minute's training, it is known after a few seconds; see 20 s of 30 before."""
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    lines = progress.TrainingProgress(1000, 0)
    # The first episode comes late. Then 10 decisions a second, from 23 s on 20.
    for seconds, decision in ((11, 20), (14, 50), (23, 140), (34, 360), (45, 580)):
        now[0] = 100.0 + seconds
        lines.episode({**ROW, "decision": decision})
    first, *others = capsys.readouterr().err.splitlines()
    assert first == "20/1000 decisions  success 0 %  ε 1.00"
    assert [line.rpartition("  ")[2] for line in others] == [
        "86 s left",  # 860 decisions, 120 in the 12 s since the first episode
        "41 s left",  # 640 decisions, 310 in 20 s
        "21 s left",  # 420 decisions, 220 in 11 s
    ]


def test_an_evaluation_never_shows_more_than_its_total(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Traces, a film and failed episodes again come after the planned episodes."""
    monkeypatch.setattr(progress, "_PERIOD", 0.0)
    shown = progress.EvaluationProgress()
    shown.plan(2)
    for label, episodes, done in (("step", 2, [1, 2]), ("traces", 2, [1, 2, 3]), ("film", 1, [1])):
        with shown(label, episodes) as report:
            for number in done:
                report(number)
    counts = [line.split(" episodes")[0] for line in capsys.readouterr().err.splitlines()]
    assert counts == ["1 of 2", "2 of 2", "3 of 4", "4 of 4", "4 of 4", "5 of 5"]


def test_an_interrupted_start_of_a_resumed_run_says_how_to_resume(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("flipperctl.training.run.resume", interrupt)
    done = call("train", "--resume", "my run", cwd=tmp_path)
    assert done.code == 130
    assert done.err == "error: interrupted. Resume with: flipperctl train --resume 'my run'\n"
