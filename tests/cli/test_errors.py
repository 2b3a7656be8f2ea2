"""Faulty files and plugins: one or two lines that name them, an exit code, and nothing is lost."""

from pathlib import Path

from flipperctl import checkpoint
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


def test_what_resume_does_not_take(short_run: Path, tmp_path: Path) -> None:
    resume = ("train", "--resume", str(short_run))
    for word in ("--config-dir=mine", "--multirun"):
        text = f"{word.partition('=')[0]}: no meaning beside --resume"
        assert text in refused(*resume, word, cwd=tmp_path)
    assert "keeps its configuration" in refused(*resume, "agent.gamma=0.9", cwd=tmp_path)
    weights = str(short_run / checkpoint.BEST)
    assert "holds only the weights" in refused("train", "--resume", weights, cwd=tmp_path)
    run = tmp_path / "sweep" / "0_seed=1"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text("seed: 1")
    for command in (["inspect", "run", "sweep"], ["train", "--resume", "sweep"]):
        error = refused(*command, cwd=tmp_path)
        assert "give one of its runs, such as sweep/0_seed=1" in error


def test_a_damaged_checkpoint_is_refused_by_every_command(short_run: Path, tmp_path: Path) -> None:
    data = bytearray((short_run / checkpoint.BEST).read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / "c.safetensors").write_bytes(data)
    for words in ("eval --checkpoint", "export onnx", "inspect checkpoint",
                  "train --resume"):  # fmt: skip
        error = refused(*words.split(), "c.safetensors", cwd=tmp_path)
        assert "c.safetensors" in error
        assert "damaged" in error


def test_an_output_that_cannot_be_written_is_refused(short_run: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for arguments in (
        ["export", "onnx", str(short_run), "--output", "file/x.onnx"],
        ["eval", "--checkpoint", str(short_run), "--episodes", "1", "--output", "file/out"],
        ["train", *QUICK, "hydra.run.dir=file/run"],
    ):
        assert "cannot be written" in refused(*arguments, cwd=tmp_path)


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
    error = refused("eval", "level", "terrain=odd", "--episodes", "20", *mine, cwd=tmp_path)
    seed = error.rpartition("; the episode's seed is ")[2].strip()
    repeat = ["inspect", "terrain", "odd", "--seed", seed, "--draws", "1"]
    assert refused(*repeat, *mine, cwd=tmp_path) == error
    # What fails before anything is drawn fails for every seed
    absent = refused("inspect", "terrain", "profile_file", "terrain.path=none.csv", cwd=tmp_path)
    assert "none.csv" in absent
    assert "seed" not in absent


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
