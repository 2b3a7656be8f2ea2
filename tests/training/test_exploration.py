"""A run of ``experiment=precise`` resumes bit for bit, whoever plays: its learner's settings."""

from pathlib import Path

import pytest
import torch

from flipperctl import checkpoint
from flipperctl.env.privileged import SIZE
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

SETTINGS = {
    "agent.exploring_share": 0.5,
    "agent.cut_at_random": True,
    "agent.privileged_value": True,
    "train.decisions": 400,
}

TIME_LEFT = 38
"""Column of the share of the time limit that is left."""


@pytest.mark.parametrize("mode", ["exact", pytest.param("fast", marks=pytest.mark.long)])
def test_a_resumed_run_equals_the_uninterrupted_one(mode: str, tmp_path: Path) -> None:
    config = short_config(**SETTINGS, **{"train.mode": mode, "train.workers": 2})
    whole, first = trainer(config, tmp_path / "whole"), trainer(config, tmp_path / "parts")
    whole.run()
    first.run(stop=lambda: first.progress.decision >= 150)
    stopped = checkpoint.read(tmp_path / "parts" / checkpoint.LAST)
    assert 150 <= stopped.document.state.decision < 400
    second = trainer(stopped.config(), tmp_path / "parts")
    second.restore(stopped)
    second.run()
    found, expected = (
        checkpoint.read(tmp_path / name / checkpoint.LAST).tensors for name in ("parts", "whole")
    )
    assert all(torch.equal(found[name], tensor) for name, tensor in expected.items())
    # Sums of three rewards that were cut bootstrap after one or two decisions.
    discounts = {round(float(d), 3) for d in expected["replay.discount"].unique()}
    assert {0.99, 0.98, 0.97} <= discounts
    # Every decision has the privileged states before and after; the share of the time falls.
    before, after = expected["replay.privileged"], expected["replay.next_privileged"]
    assert before.shape == after.shape == (len(expected["replay.discount"]), SIZE)
    assert bool((after[:, TIME_LEFT] < before[:, TIME_LEFT]).all())
    assert any(name.startswith("baselines.target.") for name in expected)
