"""What is printed to be typed next works as it is, and a file names the plugins that it needs."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.checkpoint.results import hold
from flipperctl.runtime import OnnxPolicy
from tests.cli.call import EXACT, call

RIDGE = Path("examples/ridge.py").absolute()
QUICK = [f"{key}={value}" for key, value in EXACT.items()]
CALM = '''"""A reward term of a colleague."""

from flipperctl.api import RewardTerm, Transition, reward


@reward("calm")
class Calm(RewardTerm):
    """Nothing for nothing."""

    def __call__(self, t: Transition) -> float:
        return 0.0
'''


MINE = '''"""A network of one layer."""

from flipperctl.api import Network, ObservationLayout, network


@network("mine")
class Mine(Network):
    """Linear Q-values."""

    def build(self, layout: ObservationLayout, n_actions: int):
        import torch

        return torch.nn.Linear(layout.size, n_actions)
'''
NETWORK = ("--plugins", "mine.py")
ALL = ("--plugins", "my plugins", "--plugins", "calm.py", *NETWORK)


FROM = {
    "run": "this run brings {0}.py: add --plugins run/plugins/{0}.py",
    "run.onnx": "it came from {0}.py: add --plugins {0}.py",
}
"""How the file of a missing plugin is named: a run has a copy."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three plugins, a run that needs them all, and its exported file."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "my plugins").mkdir()
    shutil.copy(RIDGE, folder / "my plugins" / "ridge.py")
    (folder / "calm.py").write_text(CALM)
    (folder / "mine.py").write_text(MINE)
    words = ["terrain=ridge", "+reward@rewards.calm=calm", "network=mine", "hydra.run.dir=run"]
    done = call("train", *words, *QUICK, *ALL, cwd=folder)
    assert done.code == 0, done.err
    typed = "--plugins 'my plugins' --plugins calm.py --plugins mine.py"
    assert f"Evaluate: flipperctl eval run {typed}\n" in done.err
    assert f"Export:   flipperctl export onnx run {typed}\n" in done.err
    refused = call("train", *words, *QUICK, *ALL, cwd=folder)
    assert refused.code == 2
    assert f"resume it with: flipperctl train --resume run {typed}, or choose" in refused.err
    export = ("export", "onnx", "run", "--output", "run.onnx")
    assert call(*export, *ALL, cwd=folder).code == 0
    return folder


def test_run_and_exported_file_name_the_plugins_files_and_no_folder(made: Path) -> None:
    expected = {("terrain", "ridge"): "ridge.py", ("reward", "calm"): "calm.py"}
    expected["network", "mine"] = "mine.py"
    document = checkpoint.read(made / "run" / checkpoint.LAST).document
    assert {(p.kind, p.name): p.file for p in document.plugins if p.file} == expected
    interface = OnnxPolicy(made / "run.onnx").interface
    assert {(p.kind, p.name): p.file for p in interface.plugins} == expected
    assert str(made).encode() not in (made / "run.onnx").read_bytes()
    shown = call("inspect", "checkpoint", "run", cwd=made)
    assert "terrain ridge (ridge.py)" in shown.out


@pytest.mark.parametrize("policy", ["run", "run.onnx"])
def test_another_terrain_needs_no_plugin_of_the_training(made: Path, policy: str) -> None:
    command = ["eval", "--checkpoint", policy, "terrain=step", "--episodes", "1", "--json"]
    network = NETWORK if policy == "run" else ()
    alone = call(*command, *network, cwd=made)
    assert alone.code == 0, alone.err
    lacking = "the return lacks rewards.calm: there is no reward plugin 'calm'; this run brings"
    assert (lacking in alone.err) == (policy == "run")  # an exported file holds no rewards
    beside = call(*command, *ALL, cwd=made)
    assert beside.err == ""
    with_plugins, without = (json.loads(done.out)["scenes"][0] for done in (beside, alone))
    assert with_plugins == without  # calm pays nothing


def test_what_trains_needs_all_plugins(made: Path) -> None:
    resume = ("train", "--resume", "run", "train.decisions=400")
    done = call(*resume, "--plugins", "calm.py", *NETWORK, cwd=made)
    assert done.code == 2
    assert "there is no terrain plugin 'ridge'; this run brings ridge.py: add" in done.err
    done = call("eval", "--checkpoint", "run", "terrain=step", cwd=made)
    assert done.code == 2
    assert f"there is no network plugin 'mine'; {FROM['run'].format('mine')}" in done.err


def test_a_run_keeps_its_plugins_and_loads_them_where_it_is_trusted(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = made / "run" / "plugins"
    assert sorted(file.name for file in kept.iterdir()) == [
        *("SHA256SUMS", "calm.py", "mine.py", "ridge.py")
    ]
    for line in (kept / "SHA256SUMS").read_text().splitlines():
        content, name = line.split("  ")
        assert hashlib.sha256((kept / name).read_bytes()).hexdigest() == content
    assert (kept / "calm.py").read_text() == CALM
    command = ("eval", "run", "--episodes", "1", "--json")
    asked = call(*command, "--plugins", "run/plugins", cwd=made)
    assert asked.code == 0, asked.err
    monkeypatch.setenv(checkpoint.TRUST, str(made))
    assert call(*command, cwd=made) == asked
    monkeypatch.setenv(checkpoint.TRUST, str(made / "my plugins"))
    assert call(*command, cwd=made).code == 2


def test_an_interrupted_run_is_resumed_with_its_plugins(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "run", tmp_path / "run")
    summary = tmp_path / "run" / "summary.json"
    summary.write_text(json.dumps({**json.loads(summary.read_text()), "finished": False}))
    shutil.copy(made / "calm.py", tmp_path)
    resume = "interrupted; resume with: flipperctl train --resume run"
    for typed, printed in (
        ([], "(and --plugins for ridge.py, mine.py, calm.py)"),  # wherever they lie
        (["calm.py"], "--plugins calm.py"),
    ):
        plugins = [word for path in typed for word in ("--plugins", path)]
        shown = " ".join(call("inspect", "run", "run", *plugins, cwd=tmp_path).out.split())
        assert f"{resume} {printed} decision" in shown
    with hold(tmp_path / "run"):
        shown = " ".join(call("inspect", "run", "run", cwd=tmp_path).out.split())
    assert "run: still running decision" in shown
