"""What the pages, the help, the changelog and the project's files say: lengths, names, agreement.

    python -m docs.lint [PAGE...]

prints a line for each fault and leaves with 1 if there is one; with pages or subcommands, it prints
their longest sentences instead. `make static` runs it. Commands and Python examples in blocks are
run by `tests/test_documentation.py`.
"""

from __future__ import annotations

import ast
import re
import shlex
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from inspect import signature
from pathlib import Path
from statistics import mean
from typing import Any

import typer.main
import yaml
from stable_baselines3 import DQN, TD3

from docs import generate
from flipperctl.cli.glossary import GLOSSARY
from flipperctl.cli.main import app
from flipperctl.text import elsewhere

ROOT = Path(__file__).parents[1]
MANUAL = [*(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md"))]
MANUAL += sorted((ROOT / "docs").rglob("*.md"))
PROSE = [*MANUAL, ROOT / "CHANGELOG.md", *sorted((ROOT / "flipperctl" / "policies").glob("*.md"))]
MEAN, MOST = 18, 35
"""Words of a sentence: largest mean of a page, and largest number of one [-]."""
CHANGELOG_LINES = 120
"""Largest number of lines of the newest version in the changelog [-]."""
README_BYTES = 8_000
"""Largest size of the README [B]."""
VAGUE = ("found", "one", "own", "told", "given", "made", "asked", "chosen", "held", "kept")
VAGUE += ("ours", "theirs", "beside", "every")
"""Names that do not say what a variable is."""
MOST_VAGUE, LANDMARKS = 1, 20
"""Largest number of each of them per 1,000 bindings, least of comments per 1,000 lines [-]."""
PACKAGES = {
    "flipperctl": "flipperctl",
    "flipperctl.configs": "configs",
    "flipperctl_plugins": "plugins",
}
"""Installed package → its folder."""

_CODE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
_NO_PROSE = re.compile(r"^(#|<!--|\(.*\)=$|:?-+:?\||\|[ :|-]+\|$)")
_END = re.compile(r"(?<=[.!?])[\"')\]`*]*\s+(?=[\"'(\[`*]*[A-Z0-9`θ])")
_SETTING = re.compile(r"([a-z_]+(?:\.[a-z_0-9]+)+)(?:=.*)?")
_FOLDERS = r"\.ci|\.github|benchmarks|configs|docs|examples|flipperctl|plugins|tests"


# Sentences


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
    parts: list[str] = []
    for paragraph in paragraphs(text):
        words = re.sub(r"`[^`]+`", "`code`", _LINK.sub(r"\1", paragraph))
        parts += [part.strip() for part in _END.split(words)]
    return [sentence for sentence in parts if re.search(r"\w", sentence)]


def length(sentence: str) -> int:
    """Return the number of words, numbers and formulas of a sentence."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def texts() -> dict[str, str]:
    """Return the prose of each page and of each subcommand's help, its examples left out."""
    pages = {str(page.relative_to(ROOT)): page.read_text() for page in PROSE}

    def walk(command: Any, path: str) -> Iterator[tuple[str, str]]:
        options = [getattr(option, "help", "") or "" for option in command.params]
        prose = re.sub(
            r"\[bold\]Examples\[/\].*?(?=\n\n\S|\Z)", "", command.help or "", flags=re.DOTALL
        )
        shown = [part for part in prose.split("\n\n") if not part.strip().startswith("flipperctl ")]
        yield path, "\n\n".join([*shown, *options])
        for name, below in getattr(command, "commands", {}).items():
            yield from walk(below, f"{path} {name}")

    return pages | dict(walk(typer.main.get_command(app), "flipperctl"))


def long_sentences() -> Iterator[str]:
    """Yield pages and help whose sentences are too long."""
    for title, text in texts().items():
        counts = {sentence: length(sentence) for sentence in sentences(text)}
        yield from (f"{title}: {n} words: {s}" for s, n in counts.items() if n > MOST)
        counted = [n for n in counts.values() if n > 3]  # cells of tables have fewer
        if counted and mean(counted) > MEAN:
            yield f"{title}: {mean(counted):.1f} words in the mean; {MEAN} are allowed"


# Names


def spans() -> list[tuple[str, str]]:
    """Return each page of the manual and text between backticks outside of blocks, each once."""
    named = (
        (str(page.relative_to(ROOT)), " ".join(span.split()))
        for page in MANUAL
        for span in re.findall(r"`([^`]+)`", _CODE.sub("", page.read_text()))
    )
    return list(dict.fromkeys(named))


def unknown_options() -> Iterator[str]:
    """Yield commands within sentences that have no such option; ``flipperctl`` may be left out."""
    program: Any = typer.main.get_command(app)
    for page, span in spans():
        words = shlex.split(span) if span.count("'") % 2 == span.count('"') % 2 == 0 else []
        words = words[1:] if words[:1] == ["flipperctl"] else words
        if len(words) < 2 or words[0] not in program.commands:
            continue
        command: Any = program
        while words and words[0] in getattr(command, "commands", {}):
            command = command.commands[words.pop(0)]
        known = {name for option in command.params for name in option.opts + option.secondary_opts}
        options = {word for word in words if word.startswith("-")}
        below = getattr(command, "commands", {}) and words and not words[0].startswith("-")
        if below or options - known - {"--help", "-m"}:
            yield f"{page}: `{span}`: {words[0] if below else sorted(options - known)} is unknown"


def unknown_settings() -> Iterator[str]:
    """Yield settings within sentences that the reference does not have."""
    known = set(re.findall(r"^\| `([\w.<>]+)` \|", generate.settings(), re.MULTILINE))
    sections = {path.partition(".")[0] for path in known if "." in path} - {"hydra"}
    pages = {str(page.relative_to(ROOT)): page.read_text() for page in MANUAL}
    arguments = {*signature(DQN).parameters, *signature(TD3).parameters}
    for page, span in spans():
        named = _SETTING.fullmatch(span)
        if not named or named[1].partition(".")[0] not in sections:
            continue
        path = re.sub(r"^rewards\.\w+\.", "rewards.<term>.", named[1])
        path = re.sub(r"^logger\.\w+\.", "logger.<logger>.", path)
        path = re.sub(r"^teacher\.(?=controller\.)", "", path)
        path = re.sub(
            r"^randomise\.(?=(sim|robot|perception)\.)", "", path
        )  # a setting by its path
        if path.startswith("agent.settings.") and path.split(".")[2] in arguments:
            path = "agent.settings"
        # A field of the plugin that the page writes is as good.
        written = re.search(rf"^    {path.rpartition('.')[2]}: ", pages[page], re.MULTILINE)
        if path not in known and not written:
            yield f"{page}: there is no setting {span}"


def strange_words() -> Iterator[str]:
    """Yield settings of the glossary and of other tools' words that do not exist, and extras."""
    known = re.findall(r"^\| `([\w.<>]+)` \|", generate.settings(), re.MULTILINE)
    sections = "|".join({path.partition(".")[0] for path in known if "." in path})
    texts = [*GLOSSARY.values(), *(text for word in elsewhere.WORDS.values() for text in word.ours)]
    named = re.findall(rf"\b(?:{sections})\.[a-z_0-9.]*[a-z0-9]\b", " ".join(texts))
    for path in dict.fromkeys(named):
        if re.sub(r"^rewards\.\w+\.", "rewards.<term>.", path) not in known:
            fields = re.findall(rf"^    {path.rpartition('.')[2]}: ", _plugin_code(), re.MULTILINE)
            if not fields:
                yield f"glossary or text/elsewhere.py: there is no setting {path}"
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    table = (ROOT / "docs" / "first_run.md").read_text()
    rows = " ".join(re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", table, re.MULTILINE))
    listed = set(re.findall(r"`(\w+)`", rows))
    if differ := listed ^ (extras.keys() - {"docs", "onnx", "robot", "dev"}):
        yield f"docs/first_run.md: pyproject.toml has other extras: {sorted(differ)}"


def _plugin_code() -> str:
    return "\n".join(file.read_text() for file in (ROOT / "plugins").rglob("*.py"))


def missing_places() -> Iterator[str]:
    """Yield files, links, modules and targets of make that are named and do not exist."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page, span in spans():
        named = re.fullmatch(rf"({_FOLDERS})/[\w./]*", span) and "NAME" not in span
        if named and not (ROOT / span).exists():
            yield f"{page}: there is no {span}"
    for path in MANUAL:
        page, text = str(path.relative_to(ROOT)), path.read_text()
        for module in re.findall(r"^\W*python -m ((?:tests|benchmarks)[\w.]*)", text, re.MULTILINE):
            if find_spec(module) is None:
                yield f"{page}: there is no module {module}"
        for target in set(re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE)) - targets:
            yield f"{page}: make has no target {target}"
    readme = (ROOT / "README.md").read_text()
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", readme):
        if not (ROOT / link).exists():
            yield f"README.md: the link {link} leads nowhere"


def places_of_a_machine() -> Iterator[str]:
    """Yield pictures whose own command, which figures carry, names a place of one machine."""
    for path in sorted((ROOT / "docs" / "images").iterdir()):
        if re.search(rb"flipperctl [ -~]*[ =]/", path.read_bytes()):
            yield f"{path.relative_to(ROOT)}: drawn with an absolute path; draw it in its folder"


def vague_names() -> Iterator[str]:
    """Yield names that stand too often in the package, and whether it has too few landmarks."""
    bound: Counter[str] = Counter()
    lines: list[str] = []
    for path in (ROOT / "flipperctl").rglob("*.py"):
        text = path.read_text()
        lines += text.splitlines()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                bound[node.id] += 1
            elif isinstance(node, ast.arg):
                bound[node.arg] += 1
    for name in VAGUE:
        if 1000 * bound[name] > MOST_VAGUE * bound.total():
            yield f"flipperctl/: {bound[name]} variables are called {name!r}; say what they are"
    comments = sum(line.lstrip().startswith("#") for line in lines)
    if 1000 * comments < LANDMARKS * len(lines):
        yield f"flipperctl/: {comments} of {len(lines)} lines are comments; long bodies need some"


# The project's files


def disagreements() -> Iterator[str]:
    """Yield what Makefile, pre-commit, workflow, pyproject and citation do not agree on."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        document = tomllib.load(file)
    project = document["project"]

    # One list of static checks, one list of supported versions of Python.
    (recipe,) = re.findall(
        r"^static:\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE
    )
    checks = {line.split("$(BIN)/")[1].removesuffix(" .") for line in recipe.splitlines()}
    (repository,) = _read(".pre-commit-config.yaml")["repos"]
    hooks = {hook["entry"].removesuffix(" --force-exclude") for hook in repository["hooks"]}
    if hooks != {f".venv/bin/{check}" for check in checks}:
        yield f"pre-commit runs {sorted(hooks)}, make static {sorted(checks)}"
    versions = [c.rpartition(" ")[2] for c in project["classifiers"] if "Python :: 3." in c]
    (job,) = _read(".github/workflows/test.yml")["jobs"].values()
    # The first is that of a robot's part, which a test runs beside another Python.
    if job["strategy"]["matrix"]["python"] != versions[1:]:
        yield f"test.yml does not run on Python {versions}, which pyproject.toml classifies"
    if project["requires-python"] != f">={versions[0]}":
        yield f"requires-python is {project['requires-python']}; {versions[0]} is classified first"

    # Every package is listed, as setuptools cannot find them by itself.
    # Folders of templates count as packages there.
    packages = {"hydra_plugins"}  # a namespace package, which has no __init__.py
    for package, folder in PACKAGES.items():
        inside = [init.parent for init in (ROOT / folder).rglob("__init__.py")]
        for place in (*inside, *(ROOT / folder).rglob("templates")):
            packages.add(".".join([package, *place.relative_to(ROOT / folder).parts]))
    if packages != (listed := set(document["tool"]["setuptools"]["packages"])):
        yield f"pyproject.toml and the folders differ in the packages {sorted(packages ^ listed)}"

    # Versions and sizes. What is not released yet is a version in development.
    package = ROOT / "examples" / "ros2" / "flipperctl_ros"
    changes = (ROOT / "CHANGELOG.md").read_text()
    version = re.findall(r"^## \[(.+)\] - ", changes, re.M)[0]
    if (project["version"] != version) != ("\n## Unreleased\n" in changes):
        yield f"CHANGELOG.md: {version} is the newest, and pyproject.toml has {project['version']}"
    for file, text in (
        (ROOT / "CITATION.cff", f"\nversion: {version}\n"),
        (package / "package.xml", f"<version>{version}</version>"),
        (package / "setup.py", f'version="{version}"'),
    ):
        if text not in file.read_text():
            yield f"{file.name} has another version than {version}"
    if (ROOT / "README.md").stat().st_size > README_BYTES:
        yield f"README.md has more than {README_BYTES} bytes"
    _, newest, *_ = re.split(r"^(?=## )", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)
    if newest.count("\n") > CHANGELOG_LINES:
        yield f"CHANGELOG.md: {newest.splitlines()[0]} has more than {CHANGELOG_LINES} lines"


def _read(name: str) -> Any:
    return yaml.load((ROOT / name).read_text(), Loader=yaml.BaseLoader)  # noqa: S506  # texts alone


CHECKS = (
    long_sentences,
    unknown_options,
    unknown_settings,
    strange_words,
    missing_places,
    places_of_a_machine,
    vague_names,
    disagreements,
)


def main(titles: list[str]) -> int:
    """Print the faults, or the longest sentences of these pages; return the exit code."""
    for title in titles:
        ordered = sorted(sentences(texts()[title]), key=length, reverse=True)
        print(f"{title}: mean {mean(n for n in map(length, ordered) if n > 3):.1f}")
        for sentence in ordered[:10]:
            print(f"  {length(sentence)}: {sentence}")
    faults = [] if titles else [fault for check in CHECKS for fault in check()]
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
