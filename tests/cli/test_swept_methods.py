"""The folder of a sweep stands for the methods of its runs, and for their training seeds."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from flipperctl import checkpoint
from flipperctl.cli.plan import make_plan
from flipperctl.evaluation.policies import _swept, entrants
from tests.cli.call import call

SHIPPED = checkpoint.read(checkpoint.shipped_policies()["generalist"])


def trained(
    run: Path, seed: int, agent: Mapping[str, Any] = {}, train: Mapping[str, Any] = {}
) -> None:
    """Write the best policy of a run with other settings than those of the shipped one."""
    config = SHIPPED.document.config
    changed = {
        "seed": seed,
        "agent": {**config.agent, **agent},
        "train": {**config.train, **train},
    }
    document = SHIPPED.document.model_copy(update={"config": config.model_copy(update=changed)})
    file = run / checkpoint.BEST
    file.parent.mkdir(parents=True)
    checkpoint.write(file, document, SHIPPED.tensors)


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path("sweep")


def test_the_folder_of_a_sweep_is_one_method_with_its_seeds(sweep: Path) -> None:
    for number, (seed, planned) in enumerate(((4, 900), (9, 1000))):  # of 900 made
        run = sweep / f"{number}_seed={seed}"
        # One went on elsewhere, and each began with a policy of its own.
        trained(run, seed, {"start_from": f"runs/{seed}"}, {"workers": 1 + number})
        (run / "config.yaml").write_text(f"train: {{decisions: {planned}}}")
        (run / "summary.json").write_text('{"finished": true, "decisions": 900}')
    (sweep / "2_seed=1" / "checkpoints").mkdir(parents=True)
    (sweep / "2_seed=1" / "config.yaml").write_text("")
    told: list[str] = []
    found = entrants(["sweep", "generalist", "okada"], told.append)
    own = SHIPPED.document.config.seed
    assert [(e.method, e.training_seed) for e in found] == [
        ("sweep", 4),
        ("sweep", 9),
        ("generalist", own),
        ("okada", None),
    ]
    assert [line.partition(":")[0] for line in told] == [
        "sweep/1_seed=9 is not trained to its end; it counts like the others",
        "sweep/2_seed=1 is left out",
    ]
    plan = make_plan(["terrain=flat"], found[:2], "none", print)
    assert [entry.named for entry in plan.entries] == ["sweep, seed 4", "sweep, seed 9"]
    assert plan.entries[1].names == {"method": "sweep", "training_seed": 9}
    flat = ("terrain=flat", "terrain.length=0.2", "--episodes", "1", "--output", "out")
    done = call("eval", "sweep", *flat, cwd=Path())
    assert done.code == 0, done.err
    assert "sweep (2 seeds)" in done.out
    for file in ("episodes.csv", "table.csv"):
        rows = list(csv.DictReader((Path("out") / file).read_text().splitlines()))
        assert {row["training_seed"] for row in rows} == {"4", "9", ""}  # a rule has none
    rows = list(csv.DictReader((Path("out") / "episodes.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"sweep", "level", "okada"}


def test_runs_of_one_seed_that_began_with_several_runs_are_several_methods(sweep: Path) -> None:
    for number, start in enumerate(("a", "b", "a")):
        run = sweep / f"{number}_agent.start_from={start}"
        trained(run, 1, {"start_from": f"runs/{start}"})
    told: list[str] = []
    methods = [entrant.method for entrant in entrants(["sweep"], told.append)]
    assert methods == ["sweep/agent.start_from=a", "sweep/agent.start_from=b"]
    assert len(told) == 1  # the third


def test_methods_of_a_sweep_have_the_names_of_what_was_swept(sweep: Path) -> None:
    names = [f"{n}_agent.learning_rate={rate},seed=1" for n, rate in enumerate((1, 2, 1))]
    for name, rate in zip(names, (0.001, 0.002, 0.001), strict=True):
        trained(sweep / name, 1, {"learning_rate": rate})
    told: list[str] = []
    methods = [entrant.method for entrant in entrants(["sweep"], told.append)]
    assert _swept(Path("0_network.hidden=_64,32_,seed=1")) == "network.hidden=_64,32_"
    assert methods == ["sweep/agent.learning_rate=1", "sweep/agent.learning_rate=2"]
    assert told == [
        f"sweep/{names[2]} is left out: sweep/{names[0]} has its seed and what it learns by"
    ]
