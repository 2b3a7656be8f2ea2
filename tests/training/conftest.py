"""Trainings that several tests read: each is trained once, by its name; never change its folder."""

from collections.abc import Callable
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.api import Listener
from flipperctl.checkpoint import Checkpoint
from flipperctl.config import TrainConfig
from flipperctl.training.episodes import EPISODES
from tests.short import few, trainer

GRADIENT: dict[str, object] = {
    "agent": "policy_gradient",
    "agent.risk": True,
    "agent.decisions": 50,
    "agent.warm_up": 1,
    "agent.anchor": 0.01,
    "agent.batch_size": 32,
}
MPC = {"teacher.controller": {"name": "mpc", "value": "", "beam": 1, "horizon": 2}}
SETUPS: dict[str, dict[str, object]] = {
    "stacked": {
        "network": {"name": "stacked", "dropout": 0.1},
        "agent.exploring_share": 0.5,
        "agent.cut_at_random": True,
        "agent.privileged_value": True,
        "agent.priority": 0.6,
    },
    "noisy": {
        "network": "noisy",
        "agent.risk": True,
        "agent.risk_horizon": 8,
        "agent.escape_temperature": 0.5,
        "agent.escape_decisions": 3,
    },
    "conv": {"network": "conv"},
    "quantile": {"network": "quantile"},
    "gradient": {**GRADIENT, "train.decisions": 200},
    "taught": {
        **MPC,
        "train.record": True,
        "network": {"name": "stacked", "window": 2},
        "agent.n_step": 2,
        "agent.priority": 0.6,
    },
    "fast": {
        "train.mode": "fast",
        "train.workers": 2,
        # A request holds the difficulty of its episode.
        "terrain": {"name": "curriculum", "start": 0.5, "up": 0.2, "down": 0.1},
    },
}


def setup(name: str, **more: object) -> TrainConfig:
    """Return the configuration of a training by its name."""
    short: dict[str, object] = {
        **{"train.decisions": 120, "train.validate_every": 60},
        **{"terrain.platform": 0.4, "episode.run_up": 0.8, "episode.run_out": 0.2},
    }
    if "terrain" in SETUPS[name]:
        del short["terrain.platform"]
    if "agent" not in SETUPS[name]:
        short["agent.learning_starts"] = 30
    return few(**{**short, **SETUPS[name], **more})


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return the folder of a finished training."""
    made: dict[str, Path] = {}

    def run(name: str) -> Path:
        if name not in made:
            made[name] = tmp_path_factory.mktemp(name)
            trainer(setup(name), made[name]).run()
        return made[name]

    return run


def require_resumes(config: TrainConfig, whole: Path, parts: Path, at: int) -> Checkpoint:
    """Train with a stop after ``at`` decisions; require the files of the whole run.

    Return the checkpoint of the stop.
    """
    first = trainer(config, parts)
    assert first.run(stop=lambda: first.progress.decision >= at)["finished"] is False
    stopped = checkpoint.read(parts / checkpoint.LAST)
    require_same_end(whole, parts)
    return stopped


def require_same_end(whole: Path, parts: Path, *listeners: Listener) -> None:
    """Resume a stopped training; require the files of the whole run."""
    stopped = checkpoint.read(parts / checkpoint.LAST)
    second = trainer(stopped.config(), parts)
    second.listeners += listeners
    second.restore(stopped)
    assert second.run()["finished"] is True
    for name in (checkpoint.BEST, checkpoint.LAST, EPISODES):  # as sha256sum sees it
        assert (parts / name).is_file() == (whole / name).is_file()
        if (whole / name).is_file():
            assert (parts / name).read_bytes() == (whole / name).read_bytes(), name
