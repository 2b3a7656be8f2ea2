"""Bad input: exit code 2, one or two lines with the fault and what is allowed; no files."""

import os
import shutil
from pathlib import Path

import pytest

from flipperctl import checkpoint
from tests.cli.call import EXACT, call, refused

QUICK = [f"{key}={value}" for key, value in EXACT.items()]


def test_an_existing_run_is_never_overwritten(short_run: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(short_run, tmp_path / "run"))
    (run / "config.yaml").write_text("mine")
    done = call("train", *QUICK, f"hydra.run.dir={run}", cwd=tmp_path)
    assert done.code == 2
    assert "already holds a run" in done.err
    assert (run / "config.yaml").read_text() == "mine"
    best = checkpoint.BEST
    assert (run / best).read_bytes() == (short_run / best).read_bytes()


@pytest.mark.parametrize("words", [["--cfg", "job"], ["--multirun"]])
def test_resume_neither_prints_nor_sweeps(
    words: list[str], short_run: Path, tmp_path: Path
) -> None:
    error = refused("train", "--resume", str(short_run), *words, cwd=tmp_path)
    assert f"{words[0]}: no meaning beside --resume" in error


def test_the_folder_of_a_sweep_is_no_run(tmp_path: Path) -> None:
    run = tmp_path / "sweep" / "0_seed=1"
    run.mkdir(parents=True)
    (run / "config.yaml").write_text("seed: 1")
    for command in (["inspect", "run", "sweep"], ["train", "--resume", "sweep"]):
        error = refused(*command, cwd=tmp_path)
        assert "give one of its runs, such as sweep/0_seed=1" in error


def test_resume_keeps_the_configuration(short_run: Path, tmp_path: Path) -> None:
    error = refused("train", "--resume", str(short_run), "agent.gamma=0.9", cwd=tmp_path)
    assert "keeps its configuration" in error
    weights = str(short_run / checkpoint.BEST)
    assert "holds only the weights" in refused("train", "--resume", weights, cwd=tmp_path)


@pytest.mark.parametrize("command", ["eval", "export", "inspect", "resume"])
@pytest.mark.parametrize("damage", ["flipped", "truncated", "pickle"])
def test_a_damaged_checkpoint_is_refused_by_every_command(
    command: str, damage: str, short_run: Path, tmp_path: Path
) -> None:
    path = tmp_path / "c.safetensors"
    data = bytearray((short_run / checkpoint.BEST).read_bytes())
    data[len(data) // 2] ^= 4
    contents = {"flipped": bytes(data), "truncated": bytes(data[:900]), "pickle": b"\x80\x04N."}
    path.write_bytes(contents[damage])
    arguments = {
        "eval": ["eval", "--checkpoint", str(path)],
        "export": ["export", "onnx", "--checkpoint", str(path)],
        "inspect": ["inspect", "checkpoint", str(path)],
        "resume": ["train", "--resume", str(path)],
    }[command]
    error = refused(*arguments, cwd=tmp_path)
    assert str(path) in error
    assert ("pickle" if damage == "pickle" else "damaged") in error


def test_an_output_that_cannot_be_written_is_refused(short_run: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    run = str(short_run)
    (tmp_path / "metrics.csv").write_text("kind,decision\n")
    for arguments in (
        ["export", "onnx", "--checkpoint", run, "--output", "file/x.onnx"],
        ["export", "onnx", "--checkpoint", run, "--output", "no/x.onnx"],
        ["export", "onnx", "--checkpoint", run, "--output", "."],
        ["eval", "--checkpoint", run, "--episodes", "1", "--output", "file/out"],
        ["inspect", "run", ".", "--output", "file/x.png"],
        ["train", *QUICK, "hydra.run.dir=file/run"],
    ):
        assert "cannot be written" in refused(*arguments, cwd=tmp_path)


def test_debug_shows_the_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from flipperctl.errors import ConfigError

    monkeypatch.setenv("FLIPPERCTL_DEBUG", "1")
    with pytest.raises(ConfigError):
        call("train", "agent.gamma=7", cwd=tmp_path)
    assert os.environ["FLIPPERCTL_DEBUG"] == "1"
