"""Ctrl-C during ``eval``: what is finished is printed and written, and marked as interrupted."""

import csv
import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from flipperctl.checkpoint import recording
from tests.cli.call import Done, call


@pytest.fixture
def interrupt(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A function that arranges signals after a number of episodes of a progress label."""

    def arrange(label: str, episodes: int, *numbers: signal.Signals) -> None:
        @contextmanager
        def progress(self: object, found: str, total: int) -> Iterator[Callable[[float], None]]:
            def report(done: float) -> None:
                if found == label and done == episodes:
                    for number in numbers:
                        signal.raise_signal(number)

            yield report

        monkeypatch.setattr("flipperctl.terminal.progress.EvaluationProgress.__call__", progress)

    return arrange


def play(folder: Path, *arguments: str) -> Done:
    episodes = () if "--episodes" in arguments else ("--episodes", "4")
    return call("eval", "--controller", "level", *episodes, *arguments, cwd=folder)


def test_the_table_and_the_files_have_what_is_finished(
    interrupt: Callable[..., None], tmp_path: Path
) -> None:
    interrupt("flat", 3, signal.SIGTERM)
    done = play(
        *(tmp_path, "terrain=flat,step", "--output", "out", "--record", "e.safetensors"),
        *("--baseline", "okada"),
    )
    assert done.code == 130
    text = "interrupted: 3 of 16 episodes are finished; not begun: step"
    assert "level on flat (interrupted: 3 of 16 episodes)" in done.out
    assert "finishing the episode; Ctrl-C again stops at once" in done.err
    assert done.err.splitlines()[-1] == f"error: {text}"
    out = tmp_path / "out"
    names = {path.name for path in out.iterdir() if path.name[0] != "."}
    tables = {"episodes.csv", "summary.json", "table.csv", "table.tex"}
    assert names == {*tables, "cells", "cells.csv"}
    with (out / "episodes.csv").open(newline="") as file:
        assert [row["episode"] for row in csv.DictReader(file)] == ["0", "1", "2"]
    document = json.loads((out / "summary.json").read_text())
    assert document["interrupted"] is True
    assert (document["finished_episodes"], document["planned_episodes"]) == (3, 16)
    assert document["not_begun"] == ["step"]
    assert "% level on flat (interrupted: 3 of 16 episodes)" in (out / "table.tex").read_text()
    assert len(recording.read(tmp_path / "e.safetensors").episodes) == 3


def test_a_baseline_is_compared_over_what_both_have(
    interrupt: Callable[..., None], tmp_path: Path
) -> None:
    whole = json.loads(play(tmp_path, "terrain=flat", "--baseline", "okada", "--json").out)
    assert "interrupted" not in whole
    interrupt("flat, okada", 2, signal.SIGINT)
    arguments = ["terrain=flat,step", "--baseline", "okada,random", "--json"]
    done = play(tmp_path, *arguments)
    assert done.code == 130
    document = json.loads(done.out)
    assert (document["finished_episodes"], document["planned_episodes"]) == (6, 24)
    (scene,) = document["scenes"]
    assert scene["episodes"] == 4
    assert "baselines" not in scene  # there is one: random has not begun
    assert (scene["baseline"]["controller"], scene["baseline"]["episodes"]) == ("okada", 2)
    assert scene["baseline"]["difference"]["t_cost"]["episodes"] == 2
    assert scene["t_cost"] == whole["scenes"][0]["t_cost"]
