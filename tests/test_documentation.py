"""What the README, the pages of ``docs/``, CONTRIBUTING and SECURITY show, works."""

import contextlib
import json
import math
import re
import runpy
import shlex
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from flipperctl import checkpoint
from flipperctl.api import ACTIONS, Outcome
from flipperctl.config import EvalConfig
from flipperctl.env import flipper_env
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation import benchmark
from flipperctl.live.drives import DriveFolder
from flipperctl.lookahead import Mpc, Planner, planner
from flipperctl.testing import checks
from tests.cli.call import EXACT, GROUPS, RUN, call
from tests.cli.test_compare import write
from tests.cli.test_sweeps import LAUNCHERS, RAY
from tests.live.test_drives import Script

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
NAMES = ("README.md", "CONTRIBUTING.md", "SECURITY.md")
PAGES = [*(ROOT / name for name in NAMES), *sorted((ROOT / "docs").rglob("*.md"))]
TEXT = "\n".join(page.read_text() for page in PAGES)
GALLERY = (ROOT / "docs" / "gallery.md").read_text()
OWN_METHOD = ROOT / "docs" / "own_method.md"
SHOWN = "runs/stair/2026-01-31_12-00-00"
FIRST = "runs/first"  # the first run of the README, which is shown where it trains
SWEPT = "runs/multirun/2026-01-31_12-00-00/0_network=at_d3qn,seed=1"
_BLOCK = re.DOTALL | re.MULTILINE
_LOOP = re.compile(r"for run in [^;]+; do (flipperctl .+); done")
LAUNCHED = [
    ["flipperctl", "train", "-m", "seed=1,2", *words] for words in (LAUNCHERS["joblib"], RAY)
]
"""They run in the tests of the launchers."""
FEWER = {"train.decisions": 150, "train.validation_episodes": 1}
"""Of them, 50 learn (``agent.learning_starts``)."""
QUICK = [f"{key}={value}" for key, value in {**EXACT, **FEWER}.items()]
WORKERS = [f"{key}={value}" for key, value in {**RUN, **FEWER}.items()]
SEARCH = {
    "planner": ["controller.budget=2000"],
    "mpc": ["controller.beam=4", "controller.horizon=4"],
}
"""Smaller searches of the controllers that look ahead."""
ELSEWHERE = {"robot shadow", "bench"}
"""Subcommands that tests of their own run (tests/ros, tests/cli/test_commands.py)."""
NIGHTLY = {"robot check", "export onnx", "tune"}
"""Subcommands that take long, and that other tests run; make long."""
LONG_WORDS = {"--check", "--film sim=mujoco"}
"""Words that take long, and that tests/cli/test_new.py and tests/figures/test_film.py have."""
SHORT = ["episode.run_up=0.8", "episode.run_out=0.5"]
"""A shorter way to the ground."""
SPARSE = ["perception.azimuths=60", *SHORT]
"""A LiDAR of fewer rays, too."""
FILM = ["--speed", "20", *SHORT]
"""A film of few pictures; tests/figures/test_film.py has what they show."""


def blocks(language: str, text: str = TEXT) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, _BLOCK)


def saved() -> dict[str, str]:
    """Return the files that a reader is asked to save, name → text."""
    return dict(re.findall(r"[Ss]ave this as `([\w.]+)`:\n\n```\w+\n(.*?)^```", TEXT, _BLOCK))


def commands(text: str = TEXT) -> list[list[str]]:
    """Return every command that is shown, each once; those of a loop over runs for one run."""
    lines = [line for block in blocks("sh", text) for line in block.splitlines()]
    lines = [_LOOP.sub(lambda loop: loop[1].replace("$run", SHOWN), line) for line in lines]
    words = [shlex.split(line, comments=True) for line in lines]
    return [list(w) for w in dict.fromkeys(map(tuple, words)) if w and w[0] == "flipperctl"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a reader has it.

    It holds a run on stair, its export, the examples and the saved files.
    """
    folder = tmp_path_factory.mktemp("documentation")
    done = call("train", "terrain=stair", f"hydra.run.dir={SHOWN}", *QUICK, cwd=folder)
    assert done.code == 0, done.err
    done = call("export", "onnx", SHOWN, "--output", "stair.onnx", cwd=folder)
    assert done.code == 0, done.err
    write(folder / "dqn" / "1", {"dqn1": 1.1, "level": 1})
    for run in (FIRST, SWEPT):
        shutil.copytree(folder / SHOWN, folder / run)
    for name in ("first.onnx", "sb3_dqn.onnx"):
        shutil.copy(folder / "stair.onnx", folder / name)
    (folder / "examples").symlink_to(ROOT / "examples")
    for name, text in saved().items():
        (folder / name).write_text(text)
    for who, terrain in (
        ("drives/me", "step"),
        ("drives/me", "uplift"),
        ("study/anna", "paper_stair"),
    ):
        driven(folder / who, terrain)
    with contextlib.chdir(folder):
        exec(example("mound.npy"), {})
    return folder


def driven(folder: Path, terrain: str) -> None:
    """Write the drive of a script."""
    config = EvalConfig(terrain=terrain)
    DriveFolder(folder, "script: test").drive(config, FlipperEnv(config=config), Script(), 0)


def example(word: str) -> str:
    """Return the only Python example with this word."""
    (found,) = [block for block in blocks("python") if word in block]
    return found


def smaller(command: list[str]) -> list[str]:
    """The same command with a budget for a test in place of the one shown."""
    found: dict[str, str] = {}
    for index, word in enumerate(with_budget(command)):
        key = word.partition("=")[0] if "=" in word else str(index)
        found.pop(key, None)
        found[key] = word
    return list(found.values())


def with_budget(command: list[str]) -> list[str]:
    """The same command with a budget for a test behind it."""
    if command[0] == "train":
        # Of a sweep two combinations: two values of its first key, one of each other.
        swept = [word for word in command if re.fullmatch(r"\w+=\w+(,\w+)+", word)]
        kept = {word: ",".join(word.split(",")[: 1 if i else 2]) for i, word in enumerate(swept)}
        command, few = [kept.get(word, word) for word in command], list[str]()
        if {"experiment=taught", "experiment=generalist"} & set(command):
            command = [*command, "teacher.controller.beam=2", "teacher.controller.horizon=2"]
        if {"experiment=generalist", "experiment=distilled"} & set(command):
            command = [*command, "teacher.final_updates=8"]
        if {"experiment=searched", "experiment=mpc_value"} & set(command):
            fast = {"beam": 1, "horizon": 1, "groups": 4}
            fewer_groups = [f"teacher.controller.{key}={n}" for key, n in fast.items()]
            command = [*command, *fewer_groups, "teacher.batch_groups=4"]
            few = ["train.decisions=40"]  # a search of the ground for each episode takes seconds
        resumed = "--resume" in command
        trials = ["hydra.sweeper.n_trials=2"] if "hydra/sweeper=optuna" in command else []
        alone = not resumed and "-m" not in command  # two of one second would share a folder
        named = "--output" in command
        if named and FIRST in command:  # the folder has that run already
            at = command.index("--output")
            command, named = [*command[:at], *command[at + 2 :]], False
        own = [f"hydra.run.dir=runs/{uuid4()}"]
        own = own if alone and not named else []
        asked = any(word.startswith(("train.workers=", "collector=")) for word in command)
        default = command == ["train", "terrain=stair"]
        quick = ["train.decisions=160"] if resumed else WORKERS if asked or default else QUICK
        return [*command, *quick, *few, *trials, *own]
    if command[0] == "tune":
        # Of a suite, each scene needs some episodes.
        grounds = ("suite=", "terrain=")
        words = ["terrain=step" if word.startswith(grounds) else word for word in command]
        return [*words, "budget=80", "--episodes", "2"]
    if "--draws" in command:
        return re.sub(r"--draws \d+", "--draws 2", " ".join(command)).split()
    if command[0] in ("watch", "demo"):
        return [*command, "--terminal", "--episodes", "1"]
    if command[:2] == ["export", "mcap"] and "perception=lidar" in command:
        return [*command, *SPARSE]
    if command[0] == "bench":
        words = re.sub(r"--repeats \d+", "", " ".join(command)).split()
        return [*words, "--small"]
    if command[:2] == ["inspect", "plugins"] and "--check" in command:
        return ["step" if word == "mujoco" else word for word in command]
    if command[0] in ("eval", "map") or command[:2] == ["inspect", "reward"]:
        (name,) = [word for word in command if word in SEARCH] or [""]
        words = re.sub(r"--episodes \d+|--speed \d+", "", " ".join(command))
        # Suites are tests/cli/test_scenes.py's.
        words = re.sub("suite=(families|sides)", "terrain=step,ramp", words)
        words = re.sub(r"(=[\d.]+:[\d.]+):\d+", r"\1:2", words)  # of a map
        words = re.sub(r"terrain=(\w+,\w+),[\w,]+", r"terrain=\1", words).split()
        sparse = SPARSE if command[0] == "eval" and "perception=lidar" in words else []
        film = FILM if "--film" in words and "drives/me" not in words else []
        if "--regret" in words:  # the references of it search
            words, sparse = [w.replace("terrain=ramp", "terrain=step") for w in words], SHORT
        return [*words, "--episodes", "1", *SEARCH.get(name, []), *sparse, *film]
    return command


@pytest.fixture
def small_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let searches that take no overrides, as with ``--passable``, and scenes be small as well."""
    plane = benchmark.find_benchmark("1").tracks["plane"]
    few = {name: plane.scenes[name] for name in ("step", "gap")}
    track = benchmark.Track(episodes=5, scenes=few)
    version = benchmark.Benchmark(about="", tracks={"plane": track})
    monkeypatch.setattr(benchmark, "find_benchmark", lambda name: version)
    for search, small in (
        (Planner, {"width": 4, "budget": 2000}),
        (Mpc, {"beam": 4, "horizon": 4}),
    ):
        build = search.build
        monkeypatch.setattr(
            search, "build", lambda self, b=build, s=small: b(self.model_copy(update=s))
        )
    monkeypatch.setattr(planner, "_STARTS", ("level",))  # not a whole drive of mpc


MAKERS = {
    name: command
    for command in reversed(commands())
    for option, name in pairwise(["", *command])
    if command[1] in ("train", "tune", "eval", "map", "export", "robot") or option == "--record"
    if name != FIRST and option in ("--output", "--record")
} | {f"{command[3]}.py": command for command in commands() if command[1] == "new"}
MAKERS["benchmarked/generalist.json"] = ["flipperctl", "benchmark", "generalist"]
"""What a command writes → the first that writes it."""


def subcommand(command: list[str]) -> str:
    """Return the words of a command before its options and settings, as ``inspect run``."""
    return " ".join(command[1 : 3 if command[1] in (*GROUPS, "export", "new") else 2])


def cases() -> Iterator[Any]:
    """Each command; all but the README's and the first of each subcommand are long."""
    first = commands((ROOT / "README.md").read_text())
    seen = set(ELSEWHERE)
    for command in commands():
        name = subcommand(command)
        shown = command in first or name not in seen
        words = {w for w in LONG_WORDS if {*w.split()} <= {*command}}
        long = name in NIGHTLY or not shown or bool(words)
        seen.add(name)
        if command not in LAUNCHED and name != "drive":  # tests/live drives
            yield pytest.param(command, id=" ".join(command), marks=[pytest.mark.long] * long)


@pytest.mark.usefixtures("small_searches")
@pytest.mark.parametrize("command", [*cases()])
def test_every_command_that_is_shown_runs(command: list[str], folder: Path) -> None:
    run(command, folder)
    assert (folder / SHOWN / checkpoint.LAST).is_file()


def run(command: list[str], folder: Path) -> None:
    """Run a command, and before it those that write what it reads."""
    for option, word in pairwise(command):
        name = word.rpartition("=")[2]
        maker = command if option in ("--output", "--record") else MAKERS.get(name, command)
        if maker != command and not (folder / name).exists():
            run(maker, folder)
    done = call(*smaller(command[1:]), cwd=folder)
    assert done.code == 0, done.err
    for word, name in pairwise(command):
        if word in ("--output", "--film"):
            assert (folder / name).exists()


def test_the_python_examples_run(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def ran(word: str, **names_before: Any) -> dict[str, Any]:
        names: dict[str, Any] = dict(names_before)
        with contextlib.chdir(folder):
            exec(example(word), names)
        return names

    names = ran("rgb_array")
    assert isinstance(names["env"].unwrapped, flipper_env.FlipperEnv)
    assert names["picture"].shape[2] == 3
    assert ran("action_space.sample")["info"]["outcome"] in [*Outcome]
    names = ran('OnnxPolicy("stair.onnx")')
    turned = [i * math.pi / 12 for i in ACTIONS[names["action"]]]
    assert names["targets"] == pytest.approx(turned)
    assert names["period"] == pytest.approx(0.6)
    loop, policy = folder / "examples/messages/loop.py", str(folder / "stair.onnx")
    monkeypatch.setattr("sys.argv", ["loop.py", policy])
    names = runpy.run_path(str(loop))
    assert names["robot"].decisions == 2
    assert all(abs(angle) <= math.pi / 6 + 1e-9 for angle in names["targets"])
    answer = ran("RobotSetup(")["answer"]
    assert (answer.state, answer.action is None) == ("driving", False)
    names = ran("CommandWatch()", answer=answer, now=answer.time)
    assert (names["speed"], names["stopped"]) == (0.2, True)
    out = capsys.readouterr().out
    assert "theta_R rad L pitch, nose up positive" in out
    assert "driving" in out


def unindented(text: str) -> str:
    """Return the lines that are not blank: pages show parts of the examples."""
    return "\n".join(line.strip() for line in text.splitlines() if line.strip())


def test_every_python_example_is_tried() -> None:
    assert [command for command in LAUNCHED if command not in commands()] == []
    library = ("flipperctl.train", "flipperctl.load", "flipperctl.plot")  # tests of their own
    tried = *library, "mound.npy", "rgb_array", 'OnnxPolicy("stair.onnx")'
    tried += "Conformance", "RobotSetup(", "CommandWatch()", "action_space.sample"
    others = set(blocks("python")) - set(saved().values()) - {example(word) for word in tried}
    others -= set(blocks("python", OWN_METHOD.read_text()))  # tests/test_own_method.py
    files = [unindented(path.read_text()) for path in (ROOT / "examples").glob("*.py")]
    assert [b for b in others if not any(unindented(b) in file for file in files)] == []


@pytest.mark.long
@pytest.mark.parametrize("section", GALLERY.split("\n## ")[1:], ids=lambda text: text.split(":")[0])
def test_the_gallery_states_what_its_commands_print(section: str, tmp_path: Path) -> None:
    """Where this fails, ``make gallery`` makes other pictures."""
    command, *_ = commands(section)
    done = call(*command[1 : command.index("--output")], "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    scenes = json.loads(done.out)["scenes"]
    printed = ", ".join(f"{scene['pitch_variation_100hz']['mean']:.2f}" for scene in scenes)
    assert section.splitlines()[0].partition(": ")[2] == printed


@pytest.mark.usefixtures("registry")
def test_the_conformance_example_keeps_the_contract(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(folder)
    names: dict[str, object] = {"__name__": "test_ridge"}
    exec(example("Conformance"), names)
    done = {check.name for check in checks(names["TestRidge"].plugin) if check() is None}
    assert {"profiles", "start", "picture"} <= done


def test_the_examples_are_those_shown(tmp_path: Path) -> None:
    ridge = ROOT / "examples" / "ridge.py"
    done = call("inspect", "terrain", "ridge", "--plugins", str(ridge), cwd=tmp_path)
    assert done.code == 0, done.err
    assert saved()["ridge.py"].split("@terrain")[1].split("def")[0] in ridge.read_text()
