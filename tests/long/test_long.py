"""A few cases of each command that CONTRIBUTING lists under "Long checks"."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.long import bags
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
            words[i + 1] = "export"
    return [*words, "--only", "export"] if "--write" in words else words


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "count"),
    [
        ("ground", 40),
        pytest.param("checkpoint", 12, marks=pytest.mark.long),
        pytest.param("onnx", 6, marks=pytest.mark.long),
    ],
)
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
