"""The place of numba's machine code: it changes with all that was compiled, and is writable."""

import ast
import importlib
import logging
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numba
import pytest
from numba.core.dispatcher import Dispatcher

from flipperctl.api import jit

MODULES = [
    "flipperctl.lookahead.dynamics",
    "flipperctl.sim.ground",
    "flipperctl.sim.mujoco.compiled",
    "flipperctl.sim.planar.compiled",
    "flipperctl.sim.planar.rays",
]


def add(a: int, b: int) -> int:
    return a + b


def test_the_cache_falls_back_to_the_user_s_folder_and_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(jit, "PACKAGE", file)  # beside which no folder can be made
    monkeypatch.setattr(jit, "_libraries", list)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    try:
        for cache, said in ((tmp_path / "cache", ""), (file, "compiles anew")):
            monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
            jit.machine_code_folder.cache_clear()
            with caplog.at_level(logging.DEBUG, "flipperctl"):
                assert jit.cached(numba.njit)(add)(1, 2) == 3
            assert said in caplog.text
            assert numba.config.CACHE_DIR == ""  # other packages' stay where numba puts them
    finally:
        jit.machine_code_folder.cache_clear()
    assert list(tmp_path.glob("cache/flipperctl/machine_code/*/*/*.nbi"))


STAND_IN = """
from pathlib import Path
import numba
from flipperctl.api import jit

jit.PACKAGE = Path(__file__).parent
jit.SOURCES = (".",)
from parts import LENGTH, twice

@jit.cached(numba.njit)
def area(width):
    return twice(width) * LENGTH

print(area(3), sum(area.stats.cache_hits.values()))
"""
PARTS = """
from flipperctl.api import jit
import numba
LENGTH = {length}

@jit.cached(numba.njit)
def twice(x):
    return {times} * x
"""


@pytest.mark.long
def test_a_change_in_another_file_or_a_constant_is_compiled(tmp_path: Path) -> None:
    (tmp_path / "main.py").write_text(STAND_IN)

    def run(length: int, times: int) -> str:
        text = textwrap.dedent(PARTS).format(length=length, times=times)
        (tmp_path / "parts.py").write_text(text)
        command = [sys.executable, "-B", str(tmp_path / "main.py")]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    assert run(5, 2) == "30 0"
    assert run(5, 2) == "30 1"  # from the cache
    assert run(5, 4) == "60 0"
    assert run(7, 4) == "84 0"


def test_the_digest_covers_sources_libraries_and_their_names(tmp_path: Path) -> None:
    (tmp_path / "code" / "inner").mkdir(parents=True)
    source, library = tmp_path / "code" / "inner" / "a.py", tmp_path / "lib.so"
    digests = set()
    for content in ("A = 1", "A = 2"):
        for structs in (b"old", b"new"):
            source.write_text(content)
            library.write_bytes(structs)
            digests.add(jit.code_digest([tmp_path / "code"], [library]))
    source.rename(source.with_name("b.py"))
    digests.add(jit.code_digest([tmp_path / "code"], [library]))
    assert len(digests) == 5
    assert [path.suffix for path in jit._libraries()].count(".py") == 1
    assert len(jit._libraries()) == 2


@pytest.mark.parametrize("name", MODULES)
def test_all_that_is_compiled_lies_in_the_digest_s_folders(name: str) -> None:
    module = importlib.import_module(name)
    used = set()
    for value in vars(module).values():
        function = getattr(value, "py_func", None) or getattr(value, "_pyfunc", None)
        if isinstance(value, Dispatcher) or type(value).__name__ == "CFunc":
            used |= set(function.__code__.co_names)
    assert used
    tree = ast.parse(Path(module.__file__).read_text())
    for statement in (node for node in tree.body if isinstance(node, ast.ImportFrom)):
        names = {alias.asname or alias.name for alias in statement.names}
        if names & used and statement.module.startswith("flipperctl"):
            assert statement.module.split(".")[1] in jit.SOURCES


def test_every_module_of_compiled_code_is_known() -> None:
    root = jit.PACKAGE
    found = [p for p in root.rglob("*.py") if "from flipperctl.api.jit import" in p.read_text()]
    dotted = [".".join(path.relative_to(root.parent).with_suffix("").parts) for path in found]
    assert sorted(dotted) == MODULES


def test_folders_of_earlier_digests_are_bounded(tmp_path: Path) -> None:
    used = tmp_path / "used"
    now = time.time()
    for age, name in enumerate(["used", "a", "b", "c", "d", "e", "f", "g"]):
        (tmp_path / name / "code").mkdir(parents=True)
        os.utime(tmp_path / name, (now, now - age * 20_000.0))
    jit._remove_unused(used)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b", "c", "d", "used"]
