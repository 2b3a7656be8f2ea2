"""Cells in a folder: written whole, read back bit for bit, never played twice."""

import csv
import json
import os
import signal
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from pydantic import Field

from flipperctl import api
from flipperctl.api import Policy
from flipperctl.checkpoint import shipped_policies
from flipperctl.config import EvalConfig, with_overrides
from flipperctl.errors import PluginFailedError, WorkerDiffersError, WriteError
from flipperctl.evaluation import play as playing
from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.evaluate import evaluate as play_plan
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.evaluation.rows import Row
from flipperctl.evaluation.store import (
    FOLDER,
    VIEW,
    EpisodeStore,
    FolderStore,
    StoreKey,
    blocks,
    played_policies,
    write_view,
)
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.requests.evaluation import episode_rows
from flipperctl.rollout import cluster
from flipperctl.rollout.pool import WorkerDiedError
from flipperctl.text import files
from flipperctl.views import evaluation

LEVEL, OKADA = (load_policy(name, "here") for name in ("level", "okada"))


def evaluate(
    scenes: Sequence[tuple[EvalConfig, PolicySource]], store: EpisodeStore | None = None
) -> Result:
    return play_plan(Plan.of_one([Entry(*scene) for scene in scenes]), store=store)


def config(episodes: int = 5, terrain: str = "flat", **more: object) -> EvalConfig:
    """A scene whose cells have two episodes, with the observation layout of ``mpc_value``."""
    numbers = {"episodes": episodes, "seed": 4, "cell": 2, **more}
    ground, layout = {"name": terrain, "length": 0.2}, {"highest": False}
    return EvalConfig(terrain=ground, perception=layout, eval=numbers)


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_blocks_end_at_multiples_and_at_gaps() -> None:
    assert list(blocks([0, 1, 2, 3, 4], 2)) == [[0, 1], [2, 3], [4]]
    assert list(blocks([1, 2, 3, 7, 9, 10], 4)) == [[1, 2, 3], [7], [9, 10]]
    assert list(blocks([], 4)) == []


def test_more_episodes_play_only_the_further_ones(tmp_path: Path, played: list[int]) -> None:
    first = evaluate([(config(3), OKADA)], store=FolderStore(tmp_path))
    assert played == [0, 1, 2]
    again = evaluate([(config(3), OKADA)], store=FolderStore(tmp_path))
    assert played == [0, 1, 2]
    assert again.played == first.played
    longer = evaluate([(config(5), OKADA)], store=FolderStore(tmp_path))
    assert played == [0, 1, 2, 3, 4]
    assert longer.rows[0].episodes[:3] == first.rows[0].episodes
    assert longer.played == evaluate([(config(5), OKADA)]).played
    ends = sorted(name.split(".")[-2] for name in contents(tmp_path))
    assert ends == ["000000-000001", "000002-000002", "000003-000003", "000004-000004"]


def test_another_policy_or_other_conditions_are_other_cells(
    tmp_path: Path, played: list[int]
) -> None:
    def judged(changed: dict[str, object], who: PolicySource = LEVEL) -> int:
        played.clear()
        chosen = with_overrides(config(1), changed)
        assert isinstance(chosen, EvalConfig)
        evaluate([(chosen, who)], store=FolderStore(tmp_path))
        return len(played)

    assert judged({}) == 1
    assert judged({"eval.jobs": 2}) == 0
    assert [judged({}, OKADA), judged({}, OKADA)] == [1, 0]
    for changed in ({"sim.friction": 0.7}, {"eval.seed": 5}, {"rewards.end.weight": 2.0}):
        assert [judged(dict(changed)), judged(dict(changed))] == [1, 0]


def test_a_file_is_its_content_wherever_it_lies(tmp_path: Path) -> None:
    shipped = PolicySource(checkpoint=shipped_policies()["mpc_value"])
    assert shipped.checkpoint is not None
    copy = tmp_path / "mine.safetensors"
    copy.write_bytes(shipped.checkpoint.read_bytes())
    one, other = PolicyIdentity.of(shipped), PolicyIdentity.of(PolicySource(checkpoint=copy))
    assert (one.digest, one.training_seed) == (other.digest, other.training_seed)
    assert one.training_seed is not None
    result = evaluate([(config(1), shipped)], store=FolderStore(tmp_path / "cells"))
    (row,) = episode_rows(result)
    assert (row["policy_hash"], row["training_seed"]) == (one.digest[:16], one.training_seed)
    assert len(row["training_hash"]) == 16
    assert list(played_policies(tmp_path / "cells").values()) == [{one.digest}]
    assert one.training is not None
    assert one.training["network"]["name"] == "at_d3qn"
    assert not {"seed", "device"} & set(one.training)


class FakePool:
    """Plays blocks in this process, the newest first; the first one's worker is lost."""

    def __init__(self, *arguments: object) -> None:
        self.calls: list[Future[object]] = []

    def submit(self, function: Callable[..., object], *arguments: object) -> Future[object]:
        future: Future[object] = Future()
        self.calls.insert(0, future)
        if len(self.calls) == 1:
            future.set_exception(WorkerDiedError("lost"))
        else:
            future.set_result(function(*arguments))
        return future

    def close(self) -> None:
        """Nothing runs."""


def test_a_node_with_other_code_ends_the_evaluation_and_stores_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class OtherCode(FakePool):
        def submit(self, function: Callable[..., object], *arguments: object) -> Future[object]:
            future: Future[object] = Future()
            future.set_exception(WorkerDiffersError("the worker on node7 has other code"))
            return future

    monkeypatch.setattr(playing, "worker_pool", lambda *_: OtherCode())
    monkeypatch.setattr(cluster, "connected", lambda *_: nullcontext())
    monkeypatch.setattr(cluster, "cpus", lambda: (2, 2))
    with pytest.raises(WorkerDiffersError, match="node7"):
        evaluate([(config(1, "flat", ray="any"), OKADA)], store=FolderStore(tmp_path))
    assert list(tmp_path.iterdir()) == []


def test_neither_the_order_of_cells_nor_ray_shows_in_the_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = [(OKADA, "flat"), (LEVEL, "flat")]
    plain = [(config(5, name), who) for who, name in scenes]
    expected = evaluate(plain, store=FolderStore(tmp_path / "here"))
    fake = FakePool()
    monkeypatch.setattr(playing, "worker_pool", lambda *_: fake)
    monkeypatch.setattr(cluster, "connected", lambda *_: nullcontext())
    monkeypatch.setattr(cluster, "cpus", lambda: (2, 2))
    over = [(config(5, name, ray="any"), who) for who, name in scenes]
    found = evaluate(over, store=FolderStore(tmp_path / "ray"))
    assert len(fake.calls) == 6
    assert [s.episodes for s in found.rows] == [s.episodes for s in expected.rows]
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")


def test_a_kill_at_any_moment_loses_only_the_open_cell(tmp_path: Path, played: list[int]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # other tests have left threads
        child = os.fork()
    if child == 0:  # the kill comes in the fourth episode
        play = EpisodeRunner.play

        def killed(self: EpisodeRunner, index: int) -> Row:
            if index == 3:
                os.kill(os.getpid(), signal.SIGKILL)
            return play(self, index)

        EpisodeRunner.play = killed  # type: ignore[method-assign]
        evaluate([(config(5), OKADA)], store=FolderStore(tmp_path))
        os._exit(0)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
    before = contents(tmp_path)
    assert [name.split(".")[-2] for name in before] == ["000000-000001"]
    found = evaluate([(config(5), OKADA)], store=FolderStore(tmp_path))
    assert played == [2, 3, 4]
    assert found.played == evaluate([(config(5), OKADA)]).played
    assert before.items() <= contents(tmp_path).items()


def test_a_full_disk_ends_the_evaluation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, chunks: object) -> None:
        raise WriteError(f"{path}: writing failed half way (No space left on device)")

    store = FolderStore(tmp_path)
    monkeypatch.setattr(files, "write_chunks", full)
    with pytest.raises(WriteError, match="No space left"):
        evaluate([(config(5), OKADA), (config(5, seed=9), LEVEL)], store=store)
    assert contents(tmp_path) == {}


def test_a_policy_that_fails_is_noted_and_the_others_are_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    play, build = EpisodeRunner.play, PolicySource.build
    built: list[PolicySource] = []

    def noted(self: PolicySource, config: EvalConfig) -> Policy:
        built.append(self)
        return build(self, config)

    def failing(self: EpisodeRunner, index: int) -> Row:
        if index == 3 and built[-1] == LEVEL:
            raise PluginFailedError("level: gone")
        return play(self, index)

    monkeypatch.setattr(PolicySource, "build", noted)
    monkeypatch.setattr(EpisodeRunner, "play", failing)
    scenes = [(config(5), LEVEL), (config(5), OKADA)]
    found = evaluate(scenes, store=FolderStore(tmp_path))
    assert [one.entry.label for one in found.rows] == ["okada"]
    assert [(f.controller, f.terrain, str(f.error)) for f in found.failures] == [
        ("level", "flat", "level: gone")
    ]
    assert evaluation.document(found)["failed"][0]["error"] == "level: gone"
    (note,) = tmp_path.glob("*.failed.json")
    assert json.loads(note.read_text())["text"] == "level: gone"
    assert note.name.split(".")[-3] == "000003-000003"
    monkeypatch.setattr(EpisodeRunner, "play", play)
    assert len(evaluate(scenes, store=FolderStore(tmp_path)).rows) == 2
    assert list(tmp_path.glob("*.failed.json")) == []


def test_a_damaged_cell_is_told_and_played_again(tmp_path: Path, played: list[int]) -> None:
    first = evaluate([(config(4), OKADA)], store=FolderStore(tmp_path))
    before = contents(tmp_path)
    cell = sorted(tmp_path.iterdir())[1]
    cell.write_text(cell.read_text()[:-40])
    played.clear()
    told: list[str] = []
    again = evaluate([(config(4), OKADA)], store=FolderStore(tmp_path, told.append))
    assert again.played == first.played
    assert played == [2, 3]
    assert told == [f"{cell} is damaged; its episodes are played again"]
    assert contents(tmp_path) == before
    # One whose episodes other cells have is removed.
    wide = cell.with_name(cell.name.replace("000002-000003", "000000-000003"))
    wide.write_text("half a ce")
    assert evaluate([(config(4), OKADA)], store=FolderStore(tmp_path)).played == first.played
    assert (played, wide.exists()) == ([2, 3], False)


def test_the_table_of_all_episodes_has_every_cell(tmp_path: Path) -> None:
    cells = tmp_path / FOLDER
    evaluate([(config(3), OKADA), (config(3), LEVEL)], store=FolderStore(cells))
    write_view(tmp_path)
    with (tmp_path / VIEW).open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["controller"] for row in table] == ["okada"] * 3 + ["level"] * 3
    assert len({row["seed"] for row in table}) == 3
    (first,) = cells.glob(f"{StoreKey.of(config(), PolicyIdentity.of(OKADA)).text}.000000-*")
    header, *rows = [json.loads(line) for line in first.read_text().splitlines()]
    assert (header["record"], header["controller"], header["engine"]) == ("cell", "okada", "planar")
    assert {row["record"] for row in rows} == {"episode"}
    mine = [row for row in table if row["cell"] == header["cell"]]
    assert [str(row["max_pitch"]) for row in rows] == [row["max_pitch"] for row in mine]


def test_cells_of_other_versions_are_used_and_counted(tmp_path: Path) -> None:
    evaluate([(config(2), OKADA)], store=FolderStore(tmp_path))
    (cell,) = tmp_path.iterdir()
    text = cell.read_text()
    header, _, rest = text.partition("\n")
    document = json.loads(header)
    document["versions"] |= {"pymunk": "6.0.0", "numpy": "1.0", "code": "12345678"}
    cell.write_text(json.dumps(document) + "\n" + rest)
    store = FolderStore(tmp_path)
    evaluate([(config(2), OKADA)], store=store)
    assert dict(store.other_versions) == {"pymunk 6.0.0": 1, "numpy 1.0": 1, "code 12345678": 1}
    cell.write_text(text)
    store = FolderStore(tmp_path)
    evaluate([(config(2), OKADA)], store=store)
    assert not store.other_versions


def test_a_file_that_a_reward_reads_is_part_of_what_is_stored(
    tmp_path: Path, played: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.txt"
    monkeypatch.setattr(type(config(1).rewards["end"]), "files_read", lambda term: (table,))
    for content, expected in (("a", [0]), ("a", []), ("b", [0])):
        table.write_text(content)
        played.clear()
        evaluate([(config(1), OKADA)], store=FolderStore(tmp_path / "cells"))
        assert played == expected, content


@pytest.mark.usefixtures("registry")
def test_the_content_of_a_path_setting_is_part_of_what_is_stored(
    tmp_path: Path, played: list[int]
) -> None:
    @api.terrain("from_file")
    class FromFile(api.Terrain):
        """A bump whose height is in a file, or in a file of a folder."""

        places: dict[str, tuple[Path, ...]] = Field({}, description="files or folders [-]")

        def generate(self, rng: np.random.Generator) -> api.Profile:
            place = self.places["height"][0]
            file = place / "h.txt" if place.is_dir() else place
            return api.Profile([(0, 0), (0.5, float(file.read_text())), (1, 0)])

    table = tmp_path / "h.txt"
    for place in (table, tmp_path):
        terrain = FromFile(places={"height": (place,)})
        for content, expected in (("0.1", [0]), ("0.1", []), ("0.2", [0])):
            table.write_text(content)
            played.clear()
            scene = with_overrides(config(1), {"terrain": terrain})
            evaluate([(scene, OKADA)], store=FolderStore(tmp_path.parent / "cells"))
            assert played == expected, (place, content)


def test_a_policy_that_is_replaced_meanwhile_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by a run that is still trained and finds a better policy."""
    shipped, file = shipped_policies(), tmp_path / "best.safetensors"
    file.write_bytes(shipped["mpc_value"].read_bytes())
    play = EpisodeRunner.play

    def replaced(self: EpisodeRunner, index: int) -> Row:
        if index == 3:
            file.write_bytes(shipped["mpc_value_large"].read_bytes())
        return play(self, index)

    monkeypatch.setattr(EpisodeRunner, "play", replaced)
    learner = PolicySource(checkpoint=file)
    scenes = [(config(5), learner), (config(5, seed=5), learner), (config(5), LEVEL)]
    found = evaluate(scenes, store=FolderStore(tmp_path / "cells"))
    assert [(one.entry.label, len(one.episodes)) for one in found.rows] == [("level", 5)]
    assert len(found.failures) == 2
    assert all("has changed since the evaluation began" in str(f.error) for f in found.failures)
    names = [file.name for file in (tmp_path / "cells").iterdir()]
    stored = [n for n in names if ".x." not in n and "failed" not in n]
    assert [name.split(".")[5] for name in stored] == ["000000-000001"]
