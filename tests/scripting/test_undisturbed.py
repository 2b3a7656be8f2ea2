"""Every public function leaves the caller's process as it is, and depends on none of its state."""

import contextlib
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

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


def _evaluation() -> flipperctl.Evaluation:
    return flipperctl.evaluate("generalist", episodes=1, baselines=[], **SHORT)


def _train(folder: Path) -> flipperctl.Run:
    network = {"name": "mlp", "hidden": [8]}
    return flipperctl.train(directory=folder / "run", network=network, train=TINY, **SHORT)


def _policy(folder: Path) -> list[object]:
    policy, env = flipperctl.load("generalist"), flipperctl.environment(terrain="flat", seed=1)
    observation, _ = env.reset(seed=1)
    policy.reset(env)
    first = policy(observation)
    policy.reset(env)
    return [first, policy.act(env.unwrapped.perception), policy.layout]


def _save(folder: Path) -> int:
    return flipperctl.save(NETWORK, flipperctl.environment(terrain="flat"), folder / "p.onnx")(
        np.zeros(33, np.float32)
    )


def _plot(folder: Path) -> int:
    rows = "".join(f"episode,{n},reached,1,1\n" for n in range(20))
    (folder / "metrics.csv").write_text(
        f"kind,decision,outcome,pitch_variation_100hz,return\n{rows}"
    )
    return len(flipperctl.plot(folder, metrics=["return"]).axes)


CASES: dict[str, Callable[[Path], Any]] = {
    "Evaluation": lambda folder: [_evaluation().scenes_frame().shape, _evaluation().show()],
    "LoadedPolicy": _policy,
    "Run": lambda folder: _train(folder).metrics_frame()["return"].tolist(),
    "environment": lambda folder: flipperctl.environment(terrain="flat").reset(seed=1)[0].tolist(),
    "evaluate": lambda folder: _evaluation().to_dict()["scenes"],
    "load": lambda folder: flipperctl.load("generalist").name,
    "plot": _plot,
    "save": _save,
    "train": lambda folder: _train(folder).summary["best"],
}


@contextlib.contextmanager
def settings_of_a_script() -> Iterator[None]:
    """Set everything otherwise than flipperctl needs it."""
    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    try:
        with torch.no_grad(), torch.autocast("cpu"), np.errstate(all="raise"):
            yield
    finally:
        torch.set_default_device(None)
        torch.set_default_dtype(torch.float32)
        torch.set_num_threads(threads)


def state() -> list[object]:
    kind, words, *rest = np.random.get_state()  # noqa: NPY002
    return [
        *(random.getstate(), kind, words.tolist(), *rest, torch.get_rng_state().tolist()),
        *(torch.get_default_dtype(), torch.get_default_device(), torch.get_num_threads()),
        *(torch.is_grad_enabled(), torch.is_autocast_enabled("cpu"), np.geterr()),
    ]


@pytest.mark.parametrize("name", flipperctl.__all__)
def test_a_public_function_disturbs_nothing_and_depends_on_nothing(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "plain").mkdir()
    expected = 8 if name == "save" else CASES[name](tmp_path / "plain")
    with settings_of_a_script():
        random.random()
        np.random.standard_normal()  # noqa: NPY002  # the second of a pair is kept
        before = state()
        result = CASES[name](tmp_path)
        assert state() == before
    assert result == expected


def test_the_first_use_of_the_interface_draws_no_random_number() -> None:
    script = (
        "import random, numpy; before = random.getstate(), numpy.random.get_state()[1].tolist()\n"
        "import flipperctl, flipperctl.env, gymnasium\n"
        "gymnasium.make('flipperctl.env:flipperctl/Flipper-v0', terrain='flat').reset()\n"
        "flipperctl.environment(terrain='flat').reset(); flipperctl.load\n"
        "assert before == (random.getstate(), numpy.random.get_state()[1].tolist())\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)
