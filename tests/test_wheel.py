"""The built wheel, installed in an empty virtual environment and run from an empty folder."""

import json
import shutil
import subprocess
import sys
import zipfile
from email import message_from_bytes
from pathlib import Path

import pytest
from numba.core.caching import UserProvidedCacheLocator

from tests.environment import Environment, interpreter

pytestmark = [pytest.mark.slow, pytest.mark.long]

ROOT = Path(__file__).parents[1]
TRAIN = ["train", "terrain=step", "seed=7", "train.decisions=300", "train.validation_episodes=2"]
TRAIN += ["train.regret_episodes=1"]

COMMANDS = """
import gymnasium
from flipperctl.cli.main import main
for command in (
    "eval --checkpoint run --episodes 2 --output judged",
    "export onnx run --output step.onnx",
    "inspect terrain stair --output stair.png",
    "inspect checkpoint run",
    "inspect run run",
    "inspect config terrain=stair",
):
    try:
        main(command.split())
    except SystemExit as left:
        assert left.code == 0, command
env = gymnasium.make("flipperctl.env:flipperctl/Flipper-v0", terrain="stair")
print(env.reset(seed=1)[0].shape)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a clean copy of what git tracks, as a fresh clone has it."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    files = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, files.split("\0")):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    build = [sys.executable, "-m", "build", "--wheel", "--outdir", str(out), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    (made,) = out.glob("*.whl")
    check = [sys.executable, "-m", "twine", "check", "--strict", str(made)]
    subprocess.run(check, check=True, capture_output=True)
    return made


def test_the_wheel_holds_every_module_and_configuration(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    sweepers = "flipperctl/cli/hydra/plugins"
    homes = (("flipperctl", "flipperctl"), ("plugins", "flipperctl_plugins"))
    homes += (("configs", "flipperctl/configs"), (sweepers, "hydra_plugins"))
    wanted = {"flipperctl/py.typed", "flipperctl_plugins/py.typed"} | {
        f"{package}/{path.relative_to(ROOT / folder)}"
        for folder, package in homes
        for path in (ROOT / folder).rglob("*.yaml" if folder == "configs" else "*.py")
        if folder == sweepers or not path.is_relative_to(ROOT / sweepers)
    }
    for pattern in ("*/templates/*.*", "*/*.html"):
        wanted |= {str(path.relative_to(ROOT)) for path in (ROOT / "flipperctl").glob(pattern)}
    assert wanted - held == set()
    assert not any(name.startswith(("tests", "examples", "benchmarks")) for name in held)


def requirements(wheel: Path) -> list[str]:
    """What the wheel asks for without any extra."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        found = message_from_bytes(archive.read(name)).get_all("Requires-Dist", [])
    return [text for text in found if "extra ==" not in text]


def reuse_machine_code(site: Path) -> None:
    """Copy what numba has compiled of equal sources, which takes it half a minute to do again."""
    place = Path("flipperctl") / "__pycache__" / "machine_code"
    for module in ("core", "lookahead", "sim", "sim/planar"):
        # Numba names the folders by the places of the sources.
        ours, theirs = (
            UserProvidedCacheLocator.get_suitable_cache_subpath(
                str(root / "flipperctl" / module / "any.py")
            )
            for root in (ROOT, site)
        )
        for compiled in (ROOT / place).glob(f"*/{ours}"):
            shutil.copytree(compiled, site / place / compiled.parent.name / theirs)


def test_the_wheel_does_the_whole_job_from_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    """It is installed beside the packages that it asks for and no others."""
    empty = tmp_path / "empty"
    empty.mkdir()
    environment = Environment.create(tmp_path / "venv", empty)
    environment.link(requirements(wheel))
    environment.install(str(wheel))  # pip checks that every requirement is met
    reuse_machine_code(environment.site)
    run, python = environment.run, environment.script("python")
    flipperctl = environment.script("flipperctl")

    run(flipperctl, *TRAIN, "hydra.run.dir=run")
    shown = run(python, "-c", COMMANDS)
    assert "name: stair" in shown  # the configuration
    assert "(33,)" in shown  # the shape of an observation
    judged = json.loads((empty / "judged" / "summary.json").read_text())
    assert judged["scenes"][0]["episodes"] == 2
    assert (empty / "step.onnx").is_file()
    assert (empty / "stair.png").is_file()
    listed = {p["name"] for p in json.loads(run(flipperctl, "inspect", "plugins", "--json"))}
    assert {"stair", "paper_step", "at_d3qn", "okada", "pitch"} <= listed
    # Hydra discovers the sweeper, which says what it needs; the wheel was installed without extras.
    search = [flipperctl, "train", "-m", "hydra/sweeper=optuna", "seed=1,2"]
    refused = environment.call(*search)
    assert refused.returncode == 2, refused.stderr
    assert "pip install 'flipperctl[optuna]'" in refused.stderr


def test_python_3_10_gets_the_part_of_a_robot(wheel: Path, tmp_path: Path) -> None:
    if (oldest := interpreter("3.10")) is None:
        pytest.skip("this machine has no Python 3.10")
    subprocess.run([oldest, "-m", "venv", tmp_path / "v"], check=True)
    environment = Environment(tmp_path / "v", tmp_path)
    python = environment.script("python")
    environment.run(python, "-m", "pip", "install", "--quiet", str(wheel))
    listed = json.loads(environment.run(python, "-m", "pip", "list", "--format=json"))
    names = {package["name"] for package in listed}
    assert {"flipperctl", "numpy", "onnxruntime"} <= names
    assert not {"torch", "pydantic", "hydra-core", "pymunk"} & names
    assert "--self-test" in environment.run(python, "-m", "flipperctl.runtime", "--help")
    refused = environment.call(environment.script("flipperctl"), "list")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "this installation has only flipperctl.runtime" in refused.stderr
