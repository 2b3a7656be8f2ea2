"""A few cases of each command that CONTRIBUTING lists under "Long checks"."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.long import bags, golden
from tests.long.files import BAD, fuzz

ROOT = Path(__file__).parents[2]
SHORT = {"--count": 100, "--early": 50, "--sweeps": 40, "--races": 100}
"""Option → what its number is divided by."""


def commands() -> list[str]:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    return re.findall(r"^python -m (tests\.long\..*)$", text, re.MULTILINE)


def short(command: str) -> list[str]:
    """Return the words of the same command with fewer cases."""
    words = shlex.split(command)
    for i, word in enumerate(words):
        if word in SHORT:
            words[i + 1] = str(-(-int(words[i + 1]) // SHORT[word]))
        elif word == "--only":
            words[i + 1] = "refusals"
    return [*words, "--only", "refusals"] if "--write" in words else words


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("long")


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("command", commands())
def test_a_few_cases_of_a_long_check_pass(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    done = subprocess.run(
        [sys.executable, "-m", *short(command)],
        cwd=folder,  # where they write
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_golden_runs_commands_apart_and_lists_what_differs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = {"command": "train terrain=stiar", "python": 'flipperctl.load("nope")'}
    done = golden.run(jobs | {"function": lambda: {"a": [1, {"seconds": 2}]}}, tmp_path)
    assert [one.code for one in done.values()] == [2, 2, 0]
    assert "'stair'" in done["command"].err
    assert done["python"].err.startswith("ConfigError: policy: ")
    entries = golden.document("function", done["function"])
    assert entries == {"function/a/0": 1}
    assert not golden.compare("part", entries, {**entries, "b": 1})
    assert golden.compare("part", {**entries, "c": 2}, {"function/a/0": 1.5})
    out = capsys.readouterr().out
    assert "part: 1 equal, 0 changed, 0 missing, 1 new" in out
    assert "changed function/a/0: 1 → 1.5\n  missing c: 2\n" in out


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("checkpoint", 12), ("onnx", 6), ("ground", 40)])
def test_damaged_files_are_refused_or_read_as_the_original(kind: str, count: int) -> None:
    with fuzz(kind, seed=0) as found:
        verdicts = list(found.run(count))
    assert len(verdicts) == count
    assert [v for v in verdicts if v[1][0] in BAD] == []
    assert sum(verdict == "refused" for _, (verdict, _) in verdicts) > count / 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", [None, "heading alone"])
def test_a_change_of_a_recording_is_reported_and_nothing_else_is(kind: str | None) -> None:
    assert bags.trial(0, kind) == ""
