"""The imports of a command before it answers, which decide its start-up time."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.call import GROUPS, SUBCOMMANDS, call

HEAVY = {"torch", "hydra", "ray", "pymunk", "numba", "gymnasium", "matplotlib", "onnxruntime"}
HEAVY |= {"omegaconf", "scipy", "safetensors", "tensorboard"}
VALUES = {"numpy", "pydantic"}


def imported(code: str) -> set[str]:
    """The modules that a fresh interpreter holds after ``code``, which may leave."""
    script = f"import sys\ntry:\n    {code}\nexcept SystemExit as left:\n    assert not left.code\n"
    script += "print('\\n'.join(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.splitlines())


def run(*arguments: str) -> set[str]:
    return imported(f"from flipperctl.cli.main import main; main({list(arguments)!r})")


def test_help_imports_only_what_draws_it() -> None:
    """One process asks for every help, and stops at the first that imports more."""
    code = f"""
import contextlib, sys
from flipperctl.cli.main import main
for command in {[[], *([group] for group in GROUPS), *SUBCOMMANDS]!r}:
    with contextlib.suppress(SystemExit):
        main([*command, "--help"])
    assert not {HEAVY | VALUES!r} & sys.modules.keys(), command
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_plugins_are_imported_to_list_them_and_none_of_their_libraries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, info = "an_installed_plugin", tmp_path / "mine-1.0.dist-info"
    (tmp_path / f"{module}.py").write_text(
        "from flipperctl.api import Terrain, terrain\n\n"
        "@terrain('mine')\nclass Mine(Terrain):\n    def generate(self, rng): ...\n"
    )
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[flipperctl.plugins]\nmine = {module}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    both = (
        "for words in (['inspect', 'plugins'], ['new', 'network', 'mine']): assert not run(words)"
    )
    listed = imported(f"from flipperctl.cli.main import run\n    {both}")
    assert listed >= {module, "flipperctl_plugins"}
    assert not listed & HEAVY


def test_the_evaluation_of_a_rule_does_not_wait_for_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    few = ("terrain=flat", "--episodes", "1")
    assert not run("eval", "--controller", "okada", *few) & {"torch", "safetensors"}


def test_importing_the_package_imports_nothing_heavy() -> None:
    assert not imported("import flipperctl") & (HEAVY | VALUES)
    assert not imported("import flipperctl.api") & HEAVY


def test_hydra_discovers_the_sweepers_without_importing_what_they_run() -> None:
    found = imported("from hydra.core.plugins import Plugins; Plugins.instance()")
    assert "hydra_plugins.flipperctl_sweepers" in found
    assert not found & {"flipperctl", "optuna"}


@pytest.mark.parametrize("command", [[], *([group] for group in GROUPS)], ids=" ".join)
def test_a_command_without_arguments_shows_its_help_and_no_error(
    command: list[str], tmp_path: Path
) -> None:
    done = call(*command, cwd=tmp_path)
    assert (done.code, done.err) == (2, "")
    assert "Usage: flipperctl" in done.out
