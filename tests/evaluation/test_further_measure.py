"""A measure that is added as a class and listed appears in rows, files, JSON and tables."""

import csv
import json
from pathlib import Path
from typing import ClassVar

import pytest

from flipperctl.api import Transition
from flipperctl.env import measures
from tests.cli.call import EXACT, call


class Highest:
    """The largest height of the chassis centre [m]."""

    name: ClassVar[str] = "highest"
    heading: ClassVar[str] = "highest [m]"
    digits: ClassVar[int] = 3
    reached_only: ClassVar[bool] = False

    def __init__(self) -> None:
        self.value = 0.0

    def add(self, t: Transition) -> None:
        self.value = max(self.value, float(t.path[:, 1].max()))


@pytest.fixture(autouse=True)
def _listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measures, "MEASURES", (*measures.MEASURES, Highest))


def test_eval_shows_it_everywhere(tmp_path: Path) -> None:
    flat = ["eval", "--controller", "level", "terrain=flat", "--episodes", "5"]
    done = call(*flat, "--json", "--output", "out", cwd=tmp_path)
    (scene,) = json.loads(done.out)["scenes"]
    # The chassis rests with its tracks' radius of 0.1 m above the ground.
    assert scene["highest"]["mean"] == pytest.approx(0.1, abs=1e-3)
    with (tmp_path / "out" / "episodes.csv").open(newline="") as file:
        assert [float(row["highest"]) for row in csv.DictReader(file)] == pytest.approx(
            [0.1] * 5, abs=1e-3
        )
    table = call(*flat, cwd=tmp_path).out
    assert "highest [m]" in table
    assert "0.100 [0.100, 0.100]" in table


def test_training_writes_it_down(tmp_path: Path) -> None:
    settings = [f"{key}={value}" for key, value in EXACT.items()]
    done = call("train", "terrain=flat", *settings, "hydra.run.dir=run", cwd=tmp_path)
    assert done.code == 0, done.err
    with (tmp_path / "run" / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(float(row["highest"]) > 0.09 for row in rows)
