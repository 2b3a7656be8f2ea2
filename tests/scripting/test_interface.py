"""The Python interface: what it trains, evaluates, loads and refuses is what the commands do."""

import contextlib
import functools
import json
import math
import os
import signal
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import flipperctl
from flipperctl import api
from flipperctl.config import EnvConfig, TrainConfig
from flipperctl.errors import (
    CheckpointError,
    ConfigError,
    FlipperctlError,
    InterruptedRunError,
    MissingExtraError,
    NonFiniteError,
    OutputError,
    PluginError,
    PolicyError,
    RequestError,
)
from flipperctl.evaluation import stored
from flipperctl.policies.source import PolicySource
from flipperctl.requests.compose import compose_train
from flipperctl.requests.evaluation import episode_rows
from flipperctl.rollout.episode import decisions
from flipperctl.runtime import OnnxPolicy
from flipperctl.scripting import interface
from flipperctl.scripting import progress as notebook
from flipperctl.scripting.settings import requested
from tests.cli.call import call
from tests.test_documentation import example

FLIPPER = "flipperctl.env:flipperctl/Flipper-v0"
BUDGET = (
    '{"decisions": 150, "validation_episodes": 1, "mode": "exact", "regret_episodes": 1},\n'
    '    agent={"learning_starts": 100}'
)


FLAT = {"terrain": "flat", "episodes": 1, "progress": False}


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder in which the first example of the page has run, and the names that it leaves."""
    folder = tmp_path_factory.mktemp("library")
    text = example("flipperctl.train").replace('{"decisions": 15_000}', BUDGET)
    names: dict[str, Any] = {}
    with contextlib.chdir(folder):
        exec(text.replace("episodes=100", "episodes=2"), names)
    return folder, names


@pytest.fixture
def env() -> gymnasium.Env:
    return gymnasium.make(FLIPPER, terrain="stair")


def test_an_evaluation_is_that_of_the_command(shown: tuple[Path, dict[str, Any]]) -> None:
    folder, names = shown
    words = ["terrain=stair,step", "--episodes", "2", "--baseline", "level", "--json"]
    done = call("eval", "--checkpoint", str(names["run"].directory), *words, cwd=folder)
    found = json.loads(done.out)
    assert found.pop("command").split()[0] == "flipperctl"  # then the words of the process
    assert names["result"].to_dict() == found


def test_a_run_has_its_files_and_its_metrics(shown: tuple[Path, dict[str, Any]]) -> None:
    folder, run = shown[0], shown[1]["run"]
    assert run.directory == folder / "runs/python"
    assert run.summary == json.loads((run.directory / "summary.json").read_text())
    first, *_, last = run.metrics()
    assert (first["kind"], first["episode"], first["loss"]) == ("episode", 1, None)
    assert (last["kind"], last["decision"]) == ("validation", 150)


def test_a_directory_with_a_run_is_refused_and_resumed(shown: tuple[Path, dict[str, Any]]) -> None:
    _, names = shown
    directory = names["run"].directory
    with pytest.raises(OutputError, match="already holds a run"):
        flipperctl.train(directory=directory)
    with pytest.raises(ConfigError, match="a resumed run keeps its configuration"):
        flipperctl.train(resume=directory, seed=2)
    with pytest.raises(ConfigError, match="a resumed run stays in its own"):
        flipperctl.train(resume=directory, directory="other")
    again = flipperctl.train(resume=names["run"], progress=False)
    assert again.summary == names["run"].summary


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        ({"terrain": ["stair", "step"]}, "terrain: several values"),
        ({"overrides": ["hydra/launcher=joblib"]}, "hydra/launcher: a training from Python"),
        ({"plugins": "ridge.py"}, "plugins: a list"),
        ({"seed": 1, "overrides": ["seed=2"]}, "seed is given twice"),
        ({"override": ["seed=2"]}, r"override: .*argument \(did you mean 'overrides'\?\)$"),
    ],
)
def test_a_wrong_training_is_refused_in_one_line(request_: dict, text: str) -> None:
    with pytest.raises(RequestError, match=text) as raised:
        flipperctl.train(**request_)
    assert raised.value.__cause__ is None


@pytest.mark.parametrize("stopped", [KeyboardInterrupt(), InterruptedRunError("interrupted")])
def test_a_stopped_training_says_how_to_resume(
    stopped: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interface, "start", lambda *given, **named: (_ for _ in ()).throw(stopped))
    with pytest.raises(InterruptedRunError) as raised:
        flipperctl.train(directory=tmp_path / "run", progress=False)
    assert f"flipperctl.train(resume={str(tmp_path / 'run')!r})" in str(raised.value)


def test_the_example_of_a_policy_runs(capsys: pytest.CaptureFixture[str]) -> None:
    exec(example("flipperctl.load"), {})
    assert capsys.readouterr().out.startswith("reached ")


@pytest.mark.parametrize("name", ["generalist", "run"])
def test_a_policy_acts_on_observations_as_in_an_evaluation(
    name: str, shown: tuple[Path, dict[str, Any]]
) -> None:
    policy = shown[1]["run"].policy() if name == "run" else flipperctl.load(name)
    assert policy.layout is not None
    env = gymnasium.make(FLIPPER, terrain="stair", perception=policy.layout.model_dump())
    assert policy.robot is not None
    source, task = PolicySource(checkpoint=policy.source.checkpoint), env.unwrapped
    made = [d.action for d in decisions(task, source.build(task.config), 3)]
    for acts_on_perceptions in (False, True):
        observation, _ = env.reset(seed=3)
        policy.reset(env)
        for action in made:
            seen = task.perception if acts_on_perceptions else observation
            assert (policy.act(seen) if acts_on_perceptions else policy(seen)) == action
            observation, *_ = env.step(action)


def test_a_controller_acts_on_the_perceptions_of_an_environment(env: gymnasium.Env) -> None:
    policy = flipperctl.load("okada", far=0.5)
    for wrong in (lambda: policy(np.zeros(18)), policy.reset):
        with pytest.raises(RequestError, match=r"okada is a controller, .*reset\(env\)"):
            wrong()
    with pytest.raises(RequestError, match=r"after env\.reset\(\)"):
        policy.reset(env)
    env.reset(seed=3)
    with pytest.raises(RequestError, match="must begin the episode"):
        policy.act(env.unwrapped.perception)
    policy.reset(env)
    assert policy.act(env.unwrapped.perception) in range(len(api.ACTIONS))
    (scene,) = flipperctl.evaluate(policy, terrain="flat", episodes=1, progress=False).scenes
    assert scene["controller"] == "okada"


def test_a_wrong_policy_observation_or_environment_is_refused(env: gymnasium.Env) -> None:
    for name, error, text in (
        ("okda", ConfigError, "did you mean 'okada'"),
        ("runs/none", CheckpointError, "no such run"),
        (3, ConfigError, "a path or a name is allowed"),
    ):
        with pytest.raises(error, match=text):
            flipperctl.load(name)
    with pytest.raises(RequestError, match="settings are those of a controller"):
        flipperctl.load("generalist", far=1)
    policy = flipperctl.load("generalist")
    with pytest.raises(PolicyError, match=rf"shape \(2,\); \({policy.layout.size},\) is allowed"):
        policy([1, 2])
    with pytest.raises(NonFiniteError):
        policy(np.full(policy.layout.size, np.nan))
    other = gymnasium.make(FLIPPER, terrain="flat", perception={"bin_width": 0.1})
    other.reset(seed=1)
    with pytest.raises(CheckpointError, match=r"bin_width=0\.15 m"):
        policy.reset(other)
    with pytest.raises(RequestError, match=r"Flipper-v0"):
        policy.reset(gymnasium.make("CartPole-v1"))


@pytest.mark.usefixtures("registry")
def test_a_function_of_the_observation_is_a_policy_of_its_name(tmp_path: Path) -> None:
    action = api.action_index(0, 0)

    def mine(observation: np.ndarray) -> np.int64:
        assert (observation.shape, observation.dtype) == ((33,), np.float32)
        return np.int64(action)

    def travel() -> list[tuple[object, object]]:
        found = flipperctl.evaluate([mine, "level"], baselines=[], output=tmp_path, **FLAT)
        rows = episode_rows(found.result)
        return [(row["controller"], pytest.approx(row["flipper_travel"], abs=0.01)) for row in rows]

    assert travel() == [("mine", 0), ("level", 0)]
    action = api.action_index(1, 0)
    assert travel() == [("mine", math.pi / 3), ("level", 0)]  # not what it did before
    methods = stored.read([str(tmp_path)], "flipper_travel").methods
    assert [method.name for method in methods] == ["mine", "level"]

    def okada(observation: np.ndarray) -> int:
        return 4

    for given, text in (
        ([lambda o: 4, lambda o: 5], "two functions are called 'lambda'; give each a name by def"),
        ([3], "a name, a path, a loaded policy or a function is allowed, not a int"),
        (okada, "there is a controller 'okada'; give the function another name"),
        (functools.partial(int), "jobs at 1"),
    ):
        with pytest.raises(RequestError, match=text):
            flipperctl.evaluate(given, jobs=2, **FLAT)
    with pytest.raises(RequestError, match="a module of torch is allowed, not a function"):
        flipperctl.save(okada, gymnasium.make(FLIPPER), tmp_path / "mine.onnx")
    action = 9
    with pytest.raises(FlipperctlError, match=r"mine.*returned 9; an integer from 0 to 8"):
        flipperctl.evaluate(mine, **FLAT)


def test_the_environment_is_that_of_a_training() -> None:
    given = {"terrain": "ramp", "conditions": "wide", "episode": {"slack": 2}}
    (config,) = compose_train(requested(given, ()))
    assert flipperctl.environment(**given).unwrapped.config == config.environment()
    paper = flipperctl.environment(rewards="paper", render_mode="rgb_array")
    assert list(paper.unwrapped.config.rewards) == ["flipper", "pitch", "end"]
    assert paper.render_mode == "rgb_array"
    for wrong, text in (
        ({"terrain": "rmap"}, "did you mean 'ramp'"),
        ({"terrain": ["stair", "ramp"]}, "terrain: several values"),
        ({"seed": -1}, "seed"),
        *(
            ({key: value}, f"{key}.* belongs to a training, and has no meaning here")
            for key, value in OF_A_TRAINING.items()
        ),
    ):
        with pytest.raises(ConfigError, match=text):
            flipperctl.environment(**wrong)
    assert set(OF_A_TRAINING) == TrainConfig.model_fields.keys() - EnvConfig.model_fields.keys() - {
        "actions", "seed",
    }  # fmt: skip
    first, again = (flipperctl.environment(terrain="stair", seed=7) for _ in range(2))
    assert (first.reset()[0] == again.reset()[0]).all()


OF_A_TRAINING = {
    **{"network": "mlp", "agent": "sb3", "train": {"decisions": 5}},
    **{"collector": "local", "teacher": {"controller": "okada"}, "eval": {"episodes": 3}},
    **{"logger": "csv", "device": "cuda"},
}


@pytest.mark.usefixtures("registry")
def test_a_saved_network_drives_as_the_network(tmp_path: Path, env: gymnasium.Env) -> None:
    torch.manual_seed(2)
    network = torch.nn.Sequential(torch.nn.Linear(33, 8), torch.nn.Dropout(), torch.nn.Linear(8, 9))
    policy = flipperctl.save(network, env, tmp_path / "mine.onnx", seed=7)
    network.eval()

    def same(observation: np.ndarray) -> int:
        return int(network(torch.from_numpy(observation)).argmax())

    found = flipperctl.evaluate([policy, same], baselines=[], **FLAT)
    file, function = episode_rows(found.result)
    assert (file["return"], file["flipper_travel"]) == (
        function["return"],
        function["flipper_travel"],
    )
    interface = OnnxPolicy(tmp_path / "mine.onnx").interface
    assert (interface.seed, interface.terrain, interface.highest) == (7, "stair", True)


@pytest.mark.parametrize(
    ("sizes", "of", "name", "text"),
    [
        ((33, 8), FLIPPER, "mine.onnx", r"shape \(2, 8\) for \(2, 33\); \(2, 9\) is allowed"),
        ((18, 9), FLIPPER, "mine.onnx", r"does not take observations \(B, 33\)"),
        ((33, 9), "CartPole-v1", "mine.onnx", r"of flipperctl is allowed \(Flipper-v0\)"),
        ((33, 9), FLIPPER, "mine.pt", r"\.onnx"),
    ],
)
def test_a_network_that_does_not_fit_is_refused(
    sizes: tuple[int, int], of: str, name: str, text: str, tmp_path: Path
) -> None:
    with pytest.raises(RequestError, match=text):
        flipperctl.save(torch.nn.Linear(*sizes), gymnasium.make(of), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("registry")
def test_workers_find_no_plugin_of_a_script() -> None:
    @api.terrain("scripted")
    class Scripted(api.Terrain):
        """Level ground."""

        def generate(self, rng: np.random.Generator) -> api.Profile:
            return api.Profile([(0, 0), (0.5, 0)])

    Scripted.__module__ = "__main__"
    with pytest.raises(PluginError, match="terrain 'scripted' is defined in this script"):
        flipperctl.train(terrain="scripted")
    with pytest.raises(PluginError, match="leave jobs at 1"):
        flipperctl.evaluate("level", terrain=Scripted(), jobs=2)
    result = flipperctl.evaluate("level", terrain=Scripted(), episodes=1, progress=False)
    assert result.scenes[0]["success_rate"] == 1


def test_data_frames_need_pandas(
    shown: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, names = shown
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"flipperctl\[frames\]"):
        names["run"].metrics_frame()
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=list))
    scenes, episodes = names["result"].scenes_frame(), names["result"].episodes_frame()
    assert [(row["scene"], row["n"]) for row in scenes] == [("stair", 2)] * 2 + [("step", 2)] * 2
    assert scenes[0]["success"] == names["result"].scenes[0]["success_rate"]
    assert len(episodes) == 8
    assert names["run"].metrics_frame() == names["run"].metrics()


def test_a_notebook_shows_progress_in_its_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    texts: list[str] = []

    def display(data: dict[str, str], *, raw: bool, display_id: bool = False) -> SimpleNamespace:
        texts.append(data["text/plain"])
        return SimpleNamespace(update=display)

    shell = SimpleNamespace(kernel=object())
    fake = ModuleType("IPython")
    fake.get_ipython, fake.display = lambda: shell, ModuleType("IPython.display")
    fake.display.display = display
    monkeypatch.setitem(sys.modules, "IPython", fake)
    monkeypatch.setitem(sys.modules, "IPython.display", fake.display)
    assert notebook.is_running()
    flipperctl.evaluate("level", terrain="flat", episodes=1)
    assert "░ 0/1 episodes  flat" in "".join(texts)
    assert texts[-1] == ""
    cell = notebook.TrainingCell(100, 0)
    cell.note("a note")
    row = {"decision": 50, "success_rate": 0.5, "epsilon": 1.0, "loss": None}
    cell.episode(row)
    cell.close()
    bar, note = texts[-1].splitlines()
    assert bar.startswith("█" * 12 + "░" * 12 + " 50/100 decisions")
    assert note == "a note"


ONE = {"terrain": "flat", "progress": False}


@pytest.fixture
def troubled(registry: dict) -> None:
    """A controller that raises, and one that interrupts its second episode."""

    @api.controller("broken")
    class Broken(api.Controller):
        """It fails."""

        def act(self, p: api.Perception) -> int:
            raise ValueError("worn out")

    begun: list[float] = []

    @api.controller("interrupting")
    class Interrupting(api.Controller):
        """Somebody presses Ctrl-C."""

        def act(self, p: api.Perception) -> int:
            if not begun:
                os.kill(os.getpid(), signal.SIGINT)
            begun.append(0.0)
            return 4


@pytest.mark.usefixtures("troubled")
def test_what_was_played_beside_a_failing_baseline_is_in_the_error() -> None:
    with pytest.raises(FlipperctlError, match="worn out") as raised:
        flipperctl.evaluate("level", baselines=["broken"], episodes=2, **ONE)
    found = raised.value.result
    assert found.scenes[0]["episodes"] == 2
    assert [failure.controller for failure in found.failures] == ["broken"]
    assert found.to_dict()["failed"][0]["controller"] == "broken"


@pytest.mark.usefixtures("troubled")
def test_what_was_played_before_a_stop_is_in_the_error() -> None:
    with pytest.raises(InterruptedRunError) as raised:
        flipperctl.evaluate("interrupting", baselines=[], episodes=3, **ONE)
    found = raised.value.result
    assert found.scenes[0]["episodes"] == 1
    assert (found.interruption.finished, found.interruption.planned) == (1, 3)
    assert found.to_dict()["interrupted"] is True
