"""A learner in one file outside of the package: it trains on rates, resumes and exports."""

from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import registry
from flipperctl.config import TrainConfig
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.export.policy import export
from flipperctl.plugging import plugins
from flipperctl.policies.trained import policy_module
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import PluginFile
from flipperctl.training.run import check
from tests.short import few, trainer
from tests.training.conftest import require_resumes

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("registry")]
FILE = Path(__file__).parents[2] / "examples" / "sac.py"


def config(**more: object) -> TrainConfig:
    plugins.load([FILE])
    settings = {
        "agent": {"name": "sac", "learning_starts": 20, "batch_size": 16},
        "actions": "rates",
        "network": {"name": "mlp", "hidden": [16]},
        "terrain": {"name": "flat", "length": 0.2},
        "train.decisions": 80,
        "train.validate_every": 40,
        "train.validation_episodes": 1,
    }
    return few(**{**settings, **more})


def test_it_trains_on_rates_resumes_bit_for_bit_and_exports_its_policy(tmp_path: Path) -> None:
    settings, whole = config(), tmp_path / "whole"
    made = trainer(settings, whole)
    before = [tensor.clone() for tensor in made.learning.policy.state_dict().values()]
    assert made.run()["finished"]
    assert made.progress.updates == 31
    after = made.learning.policy.state_dict().values()
    assert any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert len(checkpoint.read(whole / checkpoint.LAST).part("replay")["reward"]) == 80
    require_resumes(settings, whole, tmp_path / "parts", 30)
    file, saved = tmp_path / "sac.onnx", checkpoint.read(whole / checkpoint.BEST)
    export(saved, file)
    seen = np.random.default_rng(0).normal(0.0, 0.2, (20, 33)).astype(np.float32)
    with torch.inference_mode():
        rates = policy_module(saved)(torch.from_numpy(seen)).numpy()
    driven = [OnnxPolicy(file).act(row) for row in seen]
    assert np.abs(rates - np.array(driven)).max() < 2e-3


@pytest.mark.long
def test_workers_drive_for_it(tmp_path: Path) -> None:
    settings = config(**{"train.mode": "fast", "train.workers": 1})
    trainer(settings, tmp_path / "whole").run()
    require_resumes(settings, tmp_path / "whole", tmp_path / "parts", 30)


def test_what_it_does_not_go_with_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^actions: turns does not go with agent=sac; actions=r"):
        check(config(actions="turns"))
    with pytest.raises(ConfigError, match=r"^teacher: agent=sac learns from rewards alone"):
        config(**{"teacher.controller": {"name": "okada"}})
    with pytest.raises(ConfigError, match=r"^train\.record: it does not go with agent=sac"):
        config(**{"train.record": True})
    assert config().agent.first_update(config()) == (
        20,
        "learning starts after agent.learning_starts=20 decisions",
    )


def test_a_policy_outlives_the_learner_and_a_changed_state_is_refused(tmp_path: Path) -> None:
    settings = config(**{"train.decisions": 30})
    trainer(settings, tmp_path).run()
    saved = checkpoint.read(tmp_path / checkpoint.LAST)
    damaged = {k: v for k, v in saved.tensors.items() if not k.startswith("critics.1")}
    checkpoint.write(tmp_path / checkpoint.LAST, saved.document, damaged)
    with pytest.raises(CheckpointError, match=r"its state is not valid: .*critics|ModuleList"):
        trainer(settings, tmp_path).restore(checkpoint.read(tmp_path / checkpoint.LAST))
    del registry["agent", "sac"]
    best = checkpoint.read(tmp_path / checkpoint.BEST)
    assert policy_module(best)(torch.zeros(1, 33)).shape == (1, 2)
    export(best, file := tmp_path / "best.onnx")
    assert OnnxPolicy(file).interface.plugins == (PluginFile("agent", "sac", "sac.py"),)
    with pytest.raises(CheckpointError, match=r"there is no agent plugin 'sac'; .*sac\.py"):
        best.config()
