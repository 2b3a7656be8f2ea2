"""The page on methods of other libraries, and the notebooks, do what they say."""

import contextlib
import os
import re
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from torch import nn

import flipperctl
from flipperctl.runtime import OnnxPolicy
from tests.scripting.test_interface import BUDGET
from tests.test_documentation import OWN_METHOD, ROOT, blocks

pytestmark = [pytest.mark.slow, pytest.mark.long]
"""Of what they call, tests/scripting and tests/export test each part."""

NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
FEWER = {"20_000": "150", "15_000": "150", "1_000": "50", "range(1, 6)": "range(1, 2)"}
FEWER |= {', output="ruled"': ""}  # pictures and tables are those of dqn
FEWER |= {"episodes=30": "episodes=1", "--episodes 30": "--episodes 1"}
FEWER |= {'{"decisions": 150}': BUDGET, "n_steps=500, batch_size=100": "n_steps=75, batch_size=75"}


def fewer(text: str) -> str:
    for shown, tried in FEWER.items():
        text = text.replace(shown, tried)
    return text


@pytest.mark.usefixtures("registry")
def test_every_method_of_the_page_is_trained_saved_and_evaluated(tmp_path: Path) -> None:
    from stable_baselines3 import PPO, SAC

    page, examples = OWN_METHOD.read_text(), ROOT / "examples" / "own_method"
    script = (examples / "sb3_dqn.py").read_text()
    env = flipperctl.environment(terrain="uplift")
    with contextlib.chdir(tmp_path):
        names: dict[str, Any] = {"nn": nn}
        exec(fewer(script), names)
        for block in blocks("python", page):
            if "sb3_ppo.onnx" in block:
                names["model"] = PPO("MlpPolicy", env, n_steps=64).learn(64)
            if block not in script:
                exec(fewer(block), names)
        rates = flipperctl.environment(terrain="uplift", actions="rates")
        (actor,) = re.findall(r"`(nn\.Sequential\(model\.actor.+?)`", page)
        of_sac = eval(actor, {"nn": nn, "model": SAC("MlpPolicy", rates, learning_starts=50)})
        flipperctl.save(of_sac, rates, "sb3_sac.onnx", seed=1)
        exec(fewer((examples / "loop_dqn.py").read_text()), {})
    seeds = {file.stem: OnnxPolicy(file).interface.seed for file in tmp_path.glob("*.onnx")}
    assert seeds == {"sb3_dqn": 1, "sb3_ppo": 1, "sb3_sac": 1, "loop_dqn": 1, "dqn1": 1}
    assert sorted(scene["controller"] for scene in names["result"].scenes) == ["follow", "level"]
    assert (tmp_path / "dqn" / "1" / "episodes.csv").is_file()


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    book = nbformat.read(file, as_version=4)
    nbformat.validate(book)
    assert file.stat().st_size < 300_000
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    stored = [output for cell in cells for output in cell.outputs]  # readable where it is not run
    assert any("image/png" in output.get("data", {}) for output in stored)
    for cell in cells:
        cell.source = fewer(cell.source)
    NotebookClient(book, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in cells for output in cell.outputs]
    assert "rror" not in "".join(output.get("text", "") for output in outputs)
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert any("level" in output.get("data", {}).get("text/html", "") for output in outputs)
