"""No command replaces a file that is no earlier output of its own kind."""

from pathlib import Path

import pytest

from tests.cli.call import call

EVAL = ("eval", "--controller", "okada", "terrain=flat", "--episodes", "1")


@pytest.mark.parametrize(
    ("words", "suffix"),
    [
        ((*EVAL, "--film"), ".gif"),
        ((*EVAL, "--record"), ".safetensors"),
        (("replay", "failure.json", "--film"), ".gif"),
        (("export", "onnx", "--checkpoint", "generalist", "--output"), ".onnx"),
        (("export", "pt2", "--checkpoint", "generalist", "--output"), ".pt2"),
        (("export", "mjcf", "terrain=flat", "--output"), ".xml"),
        (("export", "urdf", "terrain=flat", "--output"), ".urdf"),
        (("robot", "shadow", "policy.onnx", "bag", "--output"), ".jsonl"),
        (("robot", "ground", "bag", "--output"), ".xyz"),
        (("card", "generalist", "--output"), ".md"),
        (("inspect", "terrain", "flat", "--output"), ".png"),
        (("inspect", "run", "run", "--output"), ".svg"),
        (("compare", "results", "--output"), ".pdf"),
        (("compare", "results", "--output"), ".tex"),
        (("robot", "check", "bag", "--output"), ".gif"),
    ],
    ids=lambda value: None if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_file_of_the_users_is_kept(words: tuple[str, ...], suffix: str, tmp_path: Path) -> None:
    mine, plugin = tmp_path / f"mine{suffix}", tmp_path / "plugin.py"
    for file in (mine, plugin):
        file.write_text("of the user")
    kept = call(*words, mine.name, cwd=tmp_path)
    assert kept.code == 2
    assert f"mine{suffix} exists and is kept" in kept.err
    wrong = call(*words, plugin.name, cwd=tmp_path)
    assert wrong.code == 2
    assert "the suffix is '.py'" in wrong.err
    assert {file.read_text() for file in (mine, plugin)} == {"of the user"}
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("name", ["failure_flat_3.json", "summary.json", "cells.csv", "table.tex"])
def test_a_folder_of_results_keeps_files_of_the_users(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text('{"scenes": "of the user"}')
    done = call(*EVAL, "--output", ".", cwd=tmp_path)
    assert done.code == 2
    assert f"{name} is not of an earlier result" in done.err
    assert (tmp_path / name).read_text() == '{"scenes": "of the user"}'


def test_a_training_keeps_the_results_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("of an evaluation")
    done = call("train", "terrain=flat", "experiment=quick", "hydra.run.dir=.", cwd=tmp_path)
    assert done.code == 2
    assert "summary.json is not of a run" in done.err
    assert (tmp_path / "summary.json").read_text() == "of an evaluation"
