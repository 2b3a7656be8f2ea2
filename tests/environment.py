"""A virtual environment that holds some of the installed packages, linked instead of installed.

Installing torch and its companions again takes a minute of computing and a network; a link takes
neither. What is not asked for is as absent as in an environment of its own.
"""

import csv
import os
import shutil
import subprocess
import sys
import venv
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


@dataclass(frozen=True)
class Environment:
    """A virtual environment, and the folder in which its commands run."""

    folder: Path
    cwd: Path

    @classmethod
    def create(cls, folder: Path, cwd: Path) -> "Environment":
        """Create an environment without any package, pip included."""
        venv.create(folder, with_pip=False)
        return cls(folder, cwd)

    @property
    def site(self) -> Path:
        """The folder of its packages."""
        (found,) = self.folder.glob("lib/python*/site-packages")
        return found

    def script(self, name: str) -> str:
        """Return the path of an installed script, or of ``python``."""
        return str(self.folder / "bin" / name)

    def call(self, *command: str) -> subprocess.CompletedProcess[str]:
        """Run a command without this process's settings of Python and flipperctl."""
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "FLIPPERCTL"))}
        return subprocess.run(command, cwd=self.cwd, env=clean, capture_output=True, text=True)

    def run(self, *command: str) -> str:
        """Run a command that must succeed and return its output."""
        done = self.call(*command)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def install(self, *arguments: str) -> None:
        """Install with this environment's pip; whatever is not there already is refused."""
        pip = [sys.executable, "-m", "pip", f"--python={self.script('python')}"]
        self.run(*pip, "install", "--quiet", "--no-index", *arguments)

    def link(self, requirements: Iterable[str]) -> None:
        """Link the installed distributions that meet the requirements, with all they require."""
        wanted = closure(requirements)
        owners: dict[str, set[str]] = defaultdict(set)
        files = {}
        for one in distributions():
            name = canonicalize_name(one.name)
            files[name] = {path for row in _record(one) for path in _heads(row)}
            for path in files[name]:
                owners[path].add(name)
        for name in wanted:
            home = Path(str(distribution(name).locate_file("")))
            for path in sorted(files[name]):
                # A folder that others share, as ``google`` is, is entered instead of linked.
                above = path.rpartition("/")[0]
                if owners[path] <= wanted and not (above and owners[above] <= wanted):
                    target = self.site / path
                    target.parent.mkdir(parents=True, exist_ok=True)
                    if not target.is_symlink():
                        target.symlink_to(home / path)


def _record(one: Distribution) -> Iterator[str]:
    """Yield the paths of the installed files, but not of scripts, which lie elsewhere."""
    lines = (one.read_text("RECORD") or "").splitlines()
    yield from (path for path, *_ in csv.reader(lines) if not path.startswith(("..", "/")))


def _heads(path: str) -> Iterator[str]:
    """Yield the first folders of a path: those in which distributions meet."""
    parts = path.split("/")
    for depth in range(1, min(len(parts), 3) + 1):
        yield "/".join(parts[:depth])


def closure(requirements: Iterable[str]) -> set[str]:
    """Return the names of the distributions that the requirements need, at any depth."""
    found: set[str] = set()
    seen: set[tuple[str, str]] = set()
    waiting = [(Requirement(text), "") for text in requirements]
    while waiting:
        one, extra = waiting.pop()
        if one.marker is not None and not one.marker.evaluate({"extra": extra}):
            continue
        name = canonicalize_name(one.name)
        found.add(name)
        for asked in {"", *one.extras}:
            if (name, asked) not in seen:
                seen.add((name, asked))
                waiting += [(Requirement(r), asked) for r in distribution(name).requires or ()]
    return found


def interpreter(version: str) -> Path | None:
    """A Python of a version, on the path or of pyenv."""
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    found = sorted(root.glob(f"versions/{version}.*/bin/python{version}"))
    place = shutil.which(f"python{version}")
    for each in [*found, *([Path(place)] if place else [])]:
        if subprocess.run([each, "-c", "import ensurepip"], capture_output=True).returncode == 0:
            return each
    return None
