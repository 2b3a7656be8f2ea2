"""Every public function leaves the caller's process as it is, and depends on none of its state."""

import contextlib
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import flipperctl

pytestmark = pytest.mark.slow

SHORT = {"terrain": "flat", "progress": False, "episode": {"run_out": 0.2}}
TINY = {"decisions": 20, "validation_episodes": 1, "regret_episodes": 0, "mode": "exact"}


NETWORK = torch.nn.Linear(33, 9)
torch.nn.init.constant_(NETWORK.weight, 1.0)
with torch.no_grad():
    NETWORK.bias.copy_(torch.arange(9.0))


class Script:
    """What a script computes; what takes long is computed once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()

    @cached_property
    def evaluation(self) -> flipperctl.Evaluation:
        return flipperctl.evaluate("generalist", episodes=1, baselines=[], **SHORT)

    @cached_property
    def run(self) -> flipperctl.Run:
        network = {"name": "mlp", "hidden": [8]}
        return flipperctl.train(directory=self.folder / "run", network=network, train=TINY, **SHORT)

    @cached_property
    def env(self) -> gymnasium.Env[Any, Any]:
        return flipperctl.environment(terrain="flat")


def _policy(script: Script) -> list[object]:
    policy, env = flipperctl.load("generalist"), script.env
    observation, _ = env.reset(seed=1)
    policy.reset(env)
    first = policy(observation)
    policy.reset(env)
    return [first, policy.act(env.unwrapped.perception), policy.layout]


def _save(script: Script) -> object:
    policy = flipperctl.save(NETWORK, script.env, script.folder / "p.onnx")
    return policy(np.zeros(33, np.float32))


def _plot(script: Script) -> int:
    rows = "".join(f"episode,{n},reached,1,1\n" for n in range(20))
    (script.folder / "metrics.csv").write_text(
        f"kind,decision,outcome,pitch_variation_100hz,return\n{rows}"
    )
    return len(flipperctl.plot(script.folder, metrics=["return"]).axes)


CASES: dict[str, Callable[[Script], Any]] = {
    "Evaluation": lambda script: [script.evaluation.scenes_frame().shape, script.evaluation.show()],
    "LoadedPolicy": _policy,
    "Run": lambda script: script.run.metrics_frame()["return"].tolist(),
    "environment": lambda script: script.env.reset(seed=1)[0].tolist(),
    "evaluate": lambda script: script.evaluation.to_dict()["scenes"],
    "load": lambda script: flipperctl.load("generalist").name,
    "plot": _plot,
    "save": _save,
    "train": lambda script: script.run.summary["best"],
}


@contextlib.contextmanager
def settings_of_a_script() -> Iterator[None]:
    """Set everything otherwise than flipperctl needs it."""
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    torch.set_float32_matmul_precision("medium")
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        with torch.no_grad(), torch.autocast("cpu"), np.errstate(all="raise"):
            yield
    finally:
        torch.use_deterministic_algorithms(False)
        torch.set_float32_matmul_precision("highest")
        torch.set_default_device(None)
        torch.set_default_dtype(torch.float32)
        torch.set_num_threads(threads)


def state() -> list[object]:
    kind, words, *rest = np.random.get_state()  # noqa: NPY002
    return [
        *(random.getstate(), kind, words.tolist(), *rest, torch.get_rng_state().tolist()),
        *(torch.get_default_dtype(), torch.get_default_device(), torch.get_num_threads()),
        *(torch.get_float32_matmul_precision(), torch.are_deterministic_algorithms_enabled()),
        torch.is_deterministic_algorithms_warn_only_enabled(),
        *(torch.is_grad_enabled(), torch.is_autocast_enabled("cpu"), np.geterr()),
    ]


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Script, Script]:
    folder = tmp_path_factory.mktemp("scripts")
    return Script(folder / "plain"), Script(folder / "other")


@pytest.mark.parametrize("name", flipperctl.__all__)
def test_a_public_function_disturbs_nothing_and_depends_on_nothing(
    name: str, scripts: tuple[Script, Script]
) -> None:
    plain, other = scripts
    expected = 8 if name == "save" else CASES[name](plain)
    with settings_of_a_script():
        random.random()
        np.random.standard_normal()  # noqa: NPY002  # the second of a pair is kept
        before = state()
        result = CASES[name](other)
        assert state() == before
    assert result == expected


@pytest.mark.long
def test_the_first_use_of_the_interface_draws_no_random_number() -> None:
    script = (
        "import random, numpy; before = random.getstate(), numpy.random.get_state()[1].tolist()\n"
        "import flipperctl, flipperctl.env, gymnasium\n"
        "gymnasium.make('flipperctl.env:flipperctl/Flipper-v0', terrain='flat').reset()\n"
        "flipperctl.environment(terrain='flat').reset(); flipperctl.load\n"
        "assert before == (random.getstate(), numpy.random.get_state()[1].tolist())\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)
