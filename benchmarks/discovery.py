"""Time to discover installed plugins, beyond importing their modules, in fresh processes."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.settings import Benchmark
from flipperctl.bench.settings import measure_in_turn, output, quantity

ABOUT = "plugins.load() with installed plugin modules, against importing the same modules by name"

_MODULE = '''"""Terrain {index}."""
from flipperctl.api import Profile, Terrain, terrain

@terrain("bench_{index}")
class Bench(Terrain):
    """Level."""
    def generate(self, rng):
        return Profile([(0, 0), (1, 0)])
'''
# Both processes have imported flipperctl and its own plugins before; argv: folder, module names.
_BEFORE = """
import os, sys, time
from importlib import import_module
os.environ.pop("FLIPPERCTL_PLUGINS", None)  # otherwise its plugins are loaded too
sys.path.insert(0, sys.argv[1])
import flipperctl_plugins
from flipperctl import plugins
from flipperctl.api import registry
begun = time.perf_counter()
"""
_IMPORT = "for name in sys.argv[2:]: import_module(name)"
_LOAD = "plugins.load()"
_AFTER = """
print(1e3 * (time.perf_counter() - begun))
assert sum(name.startswith("bench_") for _, name in registry) == len(sys.argv) - 2
"""


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure the time of loading and of importing [ms] in each round, and their difference.

    Raises:
        FlipperctlError: a process failed.
    """
    s = bench.settings
    with tempfile.TemporaryDirectory() as folder:
        names = install(Path(folder), s.modules)
        clocks = {
            what: _clock(what, [sys.executable, "-c", _BEFORE + line + _AFTER, folder, *names])
            for what, line in (("import", _IMPORT), ("load", _LOAD))
        }
        for clock in clocks.values():
            bench.report_progress("warm-up, to compile and cache every file", 0.0)
            clock()
        found = measure_in_turn(
            clocks, s.repeats, lambda fraction: bench.report_progress("processes in turn", fraction)
        )
    beyond = [load - pure for load, pure in zip(found["load"], found["import"], strict=True)]
    return {
        "about": f"{ABOUT}: {s.modules} modules",
        "quantities": {
            **{name: quantity(values, "ms") for name, values in found.items()},
            "load - import": quantity(beyond, "ms"),
        },
        "ratios": {},
    }


def install(folder: Path, modules: int) -> list[str]:
    """Write distributions of one module each, as pip installs them; return the module names."""
    names = []
    for index in range(modules):
        name = f"flipperctl_bench_{index}"
        (folder / f"{name}.py").write_text(_MODULE.format(index=index), "utf-8")
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[flipperctl.plugins]\nbench_{index} = {name}\n")
        names.append(name)
    return names


def _clock(what: str, process: list[str]) -> Callable[[], float]:
    return lambda: float(output(process, f"discovery: {what}"))
