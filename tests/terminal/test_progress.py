"""The progress of a training, and its interruption."""

from pathlib import Path

import pytest

from flipperctl.terminal import progress
from tests.cli.call import call


def test_the_time_left_is_unknown_at_first(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    lines = progress.Lines(1000, 0)
    row = {"loss": None, "success_rate": 0.0, "epsilon": 1.0}
    for seconds, decision in ((10, 20), (25, 250), (50, 500)):
        now[0] = 100.0 + seconds
        lines.episode({**row, "decision": decision})
    first, second, third = capsys.readouterr().err.splitlines()
    assert first.endswith("– s left")
    # 10 decisions a second: 750 take 75 s, 500 take 50 s.
    assert second.endswith("  75 s left")
    assert third.endswith("  50 s left")


def test_a_bar_keeps_quiet_about_the_time_left_as_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(progress, "_KNOWN_AFTER", 3600.0)
    bar = progress.Bar(1000, 0)
    bar.episode({"loss": None, "success_rate": 0.0, "epsilon": 1.0, "decision": 500})
    bar.close()
    assert "500/1000 decisions" in (shown := capsys.readouterr().err)
    assert "– s left" in shown


def test_an_interrupted_start_of_a_resumed_run_says_how_to_resume(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("flipperctl.runs.training.resume", interrupt)
    done = call("train", "--resume", "my run", cwd=tmp_path)
    assert done.code == 130
    assert done.err == "error: interrupted. Resume with: flipperctl train --resume 'my run'\n"
