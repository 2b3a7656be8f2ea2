"""A worker states what it computes with, and refuses to work with other code or files."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from flipperctl import api
from flipperctl.api import Terrain
from flipperctl.config import EnvConfig, EvalConfig, resolver
from flipperctl.errors import WorkerDiffersError
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.store import FolderStore
from flipperctl.plugging import plugins
from flipperctl.policies.source import load_policy
from flipperctl.rollout.statement import Statement

RIDGE = """
from flipperctl.api import Profile, Terrain, terrain

@terrain("stated_ridge")
class Ridge(Terrain):
    def generate(self, rng):
        return Profile([(0.0, 0.0), (0.6, 0.1), (1.2, 0.0)])
"""


@pytest.fixture
def ridge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A plugin file that this process has loaded, alone in its folder."""
    known = dict(api.registry)
    for name in ("_loaded", "_given", "_contents"):
        monkeypatch.setattr(plugins, name, getattr(plugins, name).copy())
    file = tmp_path / "plugins" / "ridge.py"
    file.parent.mkdir()
    file.write_text(RIDGE)
    plugins.load([file.parent])
    yield file
    api.registry.clear()
    api.registry.update(known)


def difference(statement: Statement) -> str:
    with pytest.raises(WorkerDiffersError) as raised:
        statement.enter()
    return str(raised.value)


def test_the_error_names_the_node_the_file_and_both_digests(
    ridge: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platform.node", lambda: "node7")
    code = Statement.of_code()
    code.enter()
    here = code.entries[str(ridge)][:12]
    ridge.write_text(RIDGE.replace("0.1", "0.3"))
    there = Statement.of_inputs(EnvConfig(terrain="flat"), ridge).entries[str(ridge)][:12]
    assert here != there
    text = f"{ridge} is {there} there and {here} here"
    assert difference(code) == (
        f"the worker on node7 has other code or files than this command: {text}"
    )
    ridge.unlink()
    assert f"{ridge} is missing there" in difference(code)


@pytest.mark.parametrize(
    "name",
    [
        "flipperctl/env/flipper_env.py",
        "flipperctl_plugins/terrains/obstacles.py",
        "flipperctl.configs/train.yaml",
        "numpy",
        "Python",
    ],
)
def test_other_code_another_version_and_further_files_are_refused(name: str) -> None:
    code = Statement.of_code()
    other = replace(code, entries={**code.entries, name: "1.2.3"})
    assert f"{name} is {code.entries[name][:12]} there and 1.2.3 here" in difference(other)
    if "/" in name:
        fewer = replace(code, entries={n: s for n, s in code.entries.items() if n != name})
        assert f"{name} is {code.entries[name][:12]} there and missing here" in difference(fewer)


def test_a_plugin_in_the_folder_of_the_others_that_the_driver_lacks_is_refused(ridge: Path) -> None:
    code = Statement.of_code()
    fewer = replace(code, entries={n: s for n, s in code.entries.items() if n != str(ridge)})
    assert "missing here" in difference(fewer)


def test_files_that_the_configuration_and_the_policy_read_count_too(tmp_path: Path) -> None:
    ground, policy = tmp_path / "ground.csv", tmp_path / "policy.onnx"
    ground.write_text("x,z\n0,0\n1,0.1\n2,0\n")
    policy.write_text("policy")
    terrain = resolver.create(Terrain.kind, {"name": "profile_file", "path": str(ground)}, "t")
    inputs = Statement.of_inputs(EnvConfig(terrain=terrain), policy)
    inputs.enter()
    assert inputs.entries.keys() == {"pymunk", str(ground), str(policy)}
    ground.write_text("x,z\n0,0\n1,0.2\n2,0\n")
    assert str(ground) in difference(inputs)


@pytest.mark.slow
def test_an_evaluation_stores_nothing_of_workers_that_would_play_another_ground(
    ridge: Path, tmp_path: Path
) -> None:
    """The file is replaced after this process has loaded it, as on a node that has another one."""
    ridge.write_text(RIDGE.replace("0.1", "0.3"))
    config = EvalConfig(terrain="stated_ridge", eval={"episodes": 4, "jobs": 2})
    store = FolderStore(tmp_path / "cells")
    with Player(store) as player, pytest.raises(WorkerDiffersError, match=r"ridge\.py is"):
        player.play(config, load_policy("level"), "ridge")
    assert list((tmp_path / "cells").iterdir()) == []
