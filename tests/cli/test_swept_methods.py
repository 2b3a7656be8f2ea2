"""The folder of a sweep stands for the methods of its runs, and for their training seeds."""

import csv
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.cli.methods import method_scenes
from flipperctl.config import EvalConfig
from flipperctl.policies.source import PolicySource
from flipperctl.runs.methods import _swept, entrants
from tests.cli.call import call
from tests.cli.test_several import FLAT


def test_the_folder_of_a_sweep_is_one_method_with_its_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = checkpoint.read(checkpoint.shipped_policies()["generalist"])
    for number, seed in enumerate((4, 9)):
        file = tmp_path / "sweep" / f"{number}_seed={seed}" / checkpoint.BEST
        file.parent.mkdir(parents=True)
        config = shipped.document.config
        pace = {**config.train, "workers": 1 + number}  # one went on elsewhere
        agent = {**config.agent, "start_from": f"runs/{seed}"}  # each its own
        document = shipped.document.model_copy(
            update={
                "config": config.model_copy(update={"seed": seed, "train": pace, "agent": agent})
            }
        )
        checkpoint.write(file, document, shipped.tensors)
    (tmp_path / "sweep" / "2_seed=1" / "checkpoints").mkdir(parents=True)
    (tmp_path / "sweep" / "2_seed=1" / "config.yaml").write_text("")
    for folder, planned in (("0_seed=4", 900), ("1_seed=9", 1000)):  # of 900 made
        (tmp_path / "sweep" / folder / "config.yaml").write_text(f"train: {{decisions: {planned}}}")
        summary = '{"finished": true, "decisions": 900}'
        (tmp_path / "sweep" / folder / "summary.json").write_text(summary)
    told: list[str] = []
    monkeypatch.chdir(tmp_path)
    found = entrants([Path("sweep"), Path("generalist")], "okada", told.append)
    own = shipped.document.config.seed
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
    monkeypatch.setattr(
        "flipperctl.cli.methods._Composer.of",
        lambda composer, e: [("", EvalConfig(terrain="flat"), PolicySource(e.run))],
    )
    names = method_scenes([], found[:2], [], None).names
    assert [name.method_text for name in names] == ["sweep, seed 4", "sweep, seed 9"]
    assert names[1].to_dict() == {"method": "sweep", "training_seed": 9}
    monkeypatch.undo()
    done = call("eval", "--checkpoint", "sweep", *FLAT, "--output", "out", cwd=tmp_path)
    assert done.code == 0, done.err
    for file in ("episodes.csv", "table.csv"):
        rows = list(csv.DictReader((tmp_path / "out" / file).read_text().splitlines()))
        assert {row["training_seed"] for row in rows} == {"4", "9", ""}  # a rule has none
    rows = list(csv.DictReader((tmp_path / "out" / "episodes.csv").read_text().splitlines()))
    assert {row["method"] for row in rows} == {"sweep", "level", "okada"}


def test_runs_of_one_seed_that_began_with_several_runs_are_several_methods(
    tmp_path: Path,
) -> None:
    shipped = checkpoint.read(checkpoint.shipped_policies()["generalist"])
    config = shipped.document.config
    for number, start in enumerate(("runs/a", "runs/b", "runs/a")):
        agent = {**config.agent, "start_from": start}
        document = shipped.document.model_copy(
            update={"config": config.model_copy(update={"agent": agent})}
        )
        file = tmp_path / "sweep" / f"{number}_agent.start_from={start[-1]}" / checkpoint.BEST
        file.parent.mkdir(parents=True)
        checkpoint.write(file, document, shipped.tensors)
    told: list[str] = []
    found = entrants([tmp_path / "sweep"], None, told.append)
    assert [e.method.rpartition("/")[2] for e in found] == [
        "agent.start_from=a",
        "agent.start_from=b",
    ]
    assert len(told) == 1  # the third


def test_methods_of_a_sweep_have_the_names_of_what_was_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = checkpoint.read(checkpoint.shipped_policies()["generalist"])
    names = (
        "0_agent.learning_rate=0.001,seed=1",
        "1_agent.learning_rate=0.002,seed=1",
        "2_agent.learning_rate=0.001,seed=1",
    )
    for name in names:
        file = tmp_path / "sweep" / name / checkpoint.BEST
        file.parent.mkdir(parents=True)
        rate = {"learning_rate": 0.001 if "0.001" in name else 0.002}
        config = shipped.document.config
        agent = {**config.agent, **rate}
        changed = config.model_copy(update={"seed": 1, "agent": agent})
        document = shipped.document.model_copy(update={"config": changed})
        checkpoint.write(file, document, shipped.tensors)
    told: list[str] = []
    monkeypatch.chdir(tmp_path)
    found = entrants([Path("sweep")], None, told.append)
    assert _swept(Path("0_network.hidden=_64,32_,seed=1")) == "network.hidden=_64,32_"
    assert [e.method for e in found] == [
        "sweep/agent.learning_rate=0.001",
        "sweep/agent.learning_rate=0.002",
    ]
    assert told == [
        f"sweep/{names[2]} is left out: sweep/{names[0]} has its seed and what it learns by"
    ]
