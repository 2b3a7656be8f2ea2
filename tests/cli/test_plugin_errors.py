"""Plugins that are wrong: their errors name them, and nothing is left behind."""

from pathlib import Path

import pytest

from tests.cli.call import EXACT, call, refused

QUICK = [f"{key}={value}" for key, value in EXACT.items()]

HEADER = """
import numpy as np
from flipperctl.api import Profile, RewardTerm, Network, Terrain, network, reward, terrain
"""
TERRAIN = (
    HEADER
    + """
@terrain("odd")
class Odd(Terrain):
    def generate(self, rng):
        return Profile({points})
"""
)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ("[(0, 0), (1, 0), (0.5, 0)]", ["x decreases from 1 to 0.5"]),
        ("[]", ["empty"]),
        ("[(0, 0), (1, float('nan'))]", ["point 1 is not finite"]),
        ("[(0, 0), (1, 0, 2)]", ["'odd'"]),
    ],
)
def test_a_bad_profile_names_its_terrain(points: str, words: list[str], tmp_path: Path) -> None:
    (tmp_path / "odd.py").write_text(TERRAIN.format(points=points))
    for command in (
        ["inspect", "terrain", "odd"],
        ["eval", "--controller", "level", "terrain=odd"],
        ["train", "terrain=odd"],
    ):
        error = refused(*command, "--plugins", "odd.py", cwd=tmp_path)
        assert [word for word in ["odd", *words] if word not in error] == [], error


def test_a_plugin_that_sets_its_own_settings_is_told_what_to_do(tmp_path: Path) -> None:
    source = TERRAIN.format(points="[(0, 0)]").replace(
        "        return", "        self.k = 3\n        return"
    )
    (tmp_path / "odd.py").write_text(source.replace("    def", "    k: int = 1\n    def"))
    words = ("train", "terrain=odd", "--plugins", "odd.py", *QUICK)
    error = refused(*words, cwd=tmp_path, code=1)
    assert "Odd.k cannot be set: settings do not change; keep what changes in a local" in error
    assert "pydantic" not in error


def test_ground_that_fails_for_some_seeds_alone_names_the_seed(tmp_path: Path) -> None:
    points = "[(0, 0), (1, 0.1 if rng.random() < 0.7 else float('nan'))]"
    (tmp_path / "odd.py").write_text(TERRAIN.format(points=points))
    mine = ["--plugins", "odd.py"]
    evaluation = ["eval", "--controller", "level", "terrain=odd", "--episodes", "20"]
    error = refused(*evaluation, *mine, cwd=tmp_path)
    seed = error.rpartition("; the episode's seed is ")[2].strip()
    repeat = ["inspect", "terrain", "odd", "--seed", seed, "--draws", "1"]
    assert refused(*repeat, *mine, cwd=tmp_path) == error


@pytest.mark.filterwarnings("ignore:Field name:UserWarning")
@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import nowhere_at_all", ["bad.py:1", "nowhere_at_all"]),
        ("\n\ndef broken(:\n", ["bad.py:3"]),
        ("x = 1\n", ["bad.py", "registers nothing"]),
        (TERRAIN.format(points="[]").replace("odd", "stair"), ["'stair'", "Odd", "Stair"]),
        (TERRAIN.format(points="[]").replace('"odd"', '"Not A Name"'), ["Not A Name"]),
        (
            TERRAIN.format(points="[]").replace("    def", "    name: str = 'odd'\n    def"),
            ["a setting cannot be called name"],
        ),
        (
            TERRAIN.format(points="[]").replace("    def", "    kind: str = 'x'\n    def"),
            ["kind is a part of Terrain"],
        ),
    ],
    ids=["import", "syntax", "nothing", "twice", "name", "field", "hidden"],
)
def test_a_bad_plugin_file_stops_the_command(source: str, words: list[str], tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text(source)
    for command in (["inspect", "plugins"], ["train"]):
        error = refused(*command, "--plugins", "bad.py", cwd=tmp_path)
        assert [word for word in words if word not in error] == [], error


def test_a_reward_that_returns_nan_is_named_and_stops(tmp_path: Path) -> None:
    (tmp_path / "r.py").write_text(
        HEADER
        + 'CALLS = []\n@reward("hole")\nclass Hole(RewardTerm):\n    def __call__(self, t):\n'
        "        CALLS.append(t)  # fewer are tried before a training begins\n"
        "        return 0.0 if len(CALLS) < 20 else float('nan')\n"
    )
    words = ["+reward@rewards.hole=hole", "hydra.run.dir=run", "--plugins", "r.py"]
    done = call("train", *words, *QUICK, cwd=tmp_path)
    assert done.code == 1
    assert "rewards.hole" in done.err
    assert "nan" in done.err
    assert "Error executing job" not in done.err
    shown = " ".join(call("inspect", "run", "run", cwd=tmp_path).out.split())
    assert "run: ended by an error, or killed; resume with: flipperctl train --resume run" in shown


def test_a_network_of_wrong_output_shape_is_refused(tmp_path: Path) -> None:
    (tmp_path / "n.py").write_text(
        HEADER + '@network("narrow")\nclass Narrow(Network):\n'
        "    def build(self, layout, n_actions):\n"
        "        import torch\n        return torch.nn.Linear(layout.size, n_actions - 1)\n"
    )
    done = call("train", "network=narrow", *QUICK, "--plugins", "n.py", cwd=tmp_path)
    assert done.code == 2
    assert "(2, 9)" in done.err
    assert "(2, 8)" in done.err
