"""Sentences of the pages and of ``--help`` are short: 18 words in the mean, 35 at most.

``python -m tests.test_words [PAGE...]`` prints the longest sentences of each page, or of these.
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import mean

import pytest
import typer

from flipperctl.cli.main import app

ROOT = Path(__file__).parents[1]
NAMES = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")
POLICIES = ROOT / "flipperctl" / "policies"
PAGES = [*(ROOT / name for name in NAMES), *sorted((ROOT / "docs").rglob("*.md"))]
PAGES += sorted(POLICIES.glob("*.md"))
MEAN, MOST = 18, 35
"""Words of a sentence: largest mean of a page, and largest number of one [-]."""
CHANGELOG_LINES = 150
"""Largest number of lines of a version in the changelog [-]."""
_CODE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_NO_PROSE = re.compile(r"^(#|<!--|\(.*\)=$|:?-+:?\||\|[ :|-]+\|$)")
_END = re.compile(r"(?<=[.!?])[\"')\]`*]*\s+(?=[\"'(\[`*]*[A-Z0-9`θ])")


def paragraphs(text: str) -> Iterator[str]:
    """Yield what stands together in Markdown: paragraphs, items of lists and cells of tables."""
    lines: list[str] = []
    for line in [*_CODE.sub("\n", text).splitlines(), ""]:
        bare = line.strip().lstrip("> ")
        item = re.match(r"([-*+]|\d+\.)\s+", bare)
        if not bare or item or bare.startswith("|") or _NO_PROSE.match(bare):
            yield " ".join(lines)
            lines = []
        if bare.startswith("|"):
            yield from bare.strip("|").replace("\\|", "/").split("|")
        elif bare and not _NO_PROSE.match(bare):
            lines.append(bare[item.end() :] if item else bare)


def sentences(text: str) -> list[str]:
    """Return the sentences of a Markdown text; a piece of code is one word."""
    found = []
    for paragraph in paragraphs(text):
        words = re.sub(r"`[^`]+`", "`code`", _LINK.sub(r"\1", paragraph))
        found += [part.strip() for part in _END.split(words)]
    return [sentence for sentence in found if re.search(r"\w", sentence)]


def length(sentence: str) -> int:
    """Return the number of words, numbers and formulas of a sentence."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def helps() -> Iterator[tuple[str, str]]:
    """Yield the help of each subcommand and of its options and arguments."""

    def walk(command: object, path: str) -> Iterator[tuple[str, str]]:
        texts = [getattr(command, "help", "") or "", *(_help(p) for p in _parameters(command))]
        prose = re.sub(r"\[bold\]Examples\[/\].*?(?=\n\n\S|\Z)", "", texts[0], flags=re.DOTALL)
        shown = [line for line in prose.split("\n\n") if not line.strip().startswith("flipperctl ")]
        yield path, "\n\n".join([*shown, *texts[1:]])
        for name, below in getattr(command, "commands", {}).items():
            yield from walk(below, f"{path} {name}")

    yield from walk(typer.main.get_command(app), "flipperctl")


def _parameters(command: object) -> list[object]:
    return list(getattr(command, "params", []))


def _help(parameter: object) -> str:
    return getattr(parameter, "help", "") or ""


def texts() -> dict[str, str]:
    """Return the prose of each page and of each subcommand's help."""
    return {str(page.relative_to(ROOT)): page.read_text() for page in PAGES} | dict(helps())


@pytest.mark.parametrize("name", texts())
def test_sentences_are_short(name: str) -> None:
    found = sentences(texts()[name])
    long = [sentence for sentence in found if length(sentence) > MOST]
    assert long == []
    counted = [n for n in map(length, found) if n > 3]  # cells of tables have fewer
    assert not counted or mean(counted) <= MEAN


def test_a_version_of_the_changelog_is_what_a_user_notices() -> None:
    _, *versions = re.split(r"^(?=## )", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    assert [text for text in versions if text.count("\n") > CHANGELOG_LINES] == []


if __name__ == "__main__":
    for title, text in texts().items():
        if not sys.argv[1:] or title in sys.argv[1:]:
            all_of_it = sorted(sentences(text), key=length, reverse=True)
            lengths = [n for n in map(length, all_of_it) if n > 3] or [0]
            over = [sentence for sentence in all_of_it if length(sentence) > MOST]
            print(f"{title}: mean {mean(lengths):.1f}, over {MOST}: {len(over)}")
            for sentence in over if sys.argv[1:] else []:
                print(f"  {length(sentence)}: {sentence}")
