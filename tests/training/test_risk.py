"""A training with a risk: what it learns, how it is calibrated, and that it reaches every file."""

import math
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import Outcome
from flipperctl.config import Agent, EnvConfig
from flipperctl.core.risk import RiskSign
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError
from flipperctl.evaluation.workers import EpisodeRunner
from flipperctl.export import policy
from flipperctl.policies.abilities import RiskPolicy
from flipperctl.policies.source import PolicySource
from flipperctl.policies.trained import policy_risk
from flipperctl.rollout.episode import EpisodeRisks, Row, play
from flipperctl.training.validation import calibrated, fit
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def risky_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("risky_run")
    trainer(short_config(**{"agent.risk": True, "agent.risk_horizon": 8}), folder).run()
    return folder


def test_the_policy_of_a_training_is_the_same_with_a_risk(short_run: Path, risky_run: Path) -> None:
    plain, risky = (checkpoint.read(run / checkpoint.LAST) for run in (short_run, risky_run))
    for name, tensor in plain.tensors.items():
        assert torch.equal(risky.tensors[name], tensor), name
    further = {name.partition(".")[0] for name in risky.tensors.keys() - plain.tensors.keys()}
    assert further == {"risk", "risk_optimiser", "replay"}


def test_each_validation_calibrates_the_risk_and_the_checkpoint_has_the_numbers(
    risky_run: Path,
) -> None:
    best = checkpoint.read(risky_run / checkpoint.BEST)
    assert best.document.validation is not None
    found = best.document.validation.__pydantic_extra__
    assert found["risk_reached"] + found["risk_failures"] == 3
    assert found["risk_announced"] <= found["risk_failures"]
    risk = policy_risk(best)
    assert risk is not None
    assert risk.sign == RiskSign(8, found["risk_threshold"])
    last = policy_risk(checkpoint.read(risky_run / checkpoint.LAST))
    assert last is not None
    assert last.sign.horizon == 8


def test_a_checkpoint_without_the_weights_of_its_risk_is_refused(risky_run: Path) -> None:
    best = checkpoint.read(risky_run / checkpoint.BEST)
    del best.tensors["risk.layers.0.weight"]
    with pytest.raises(CheckpointError, match=r"its risk is not valid: layers\.0\.weight is miss"):
        policy_risk(best)


def test_the_exported_file_tells_the_risk_of_the_checkpoint(
    risky_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(policy, "OBSERVATIONS", 20)  # enough here
    best, file = checkpoint.read(risky_run / checkpoint.BEST), tmp_path / "p.onnx"
    found = policy.export(best, "onnx", file)
    assert found["largest_risk_difference"] < 1e-4
    outputs = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"]).get_outputs()
    assert [one.name for one in outputs] == ["q_values", "risk", "risk_recurrence"]
    config = EnvConfig(terrain="step")
    env = FlipperEnv(config=config)
    rows = []
    for path in (risky_run / checkpoint.BEST, file):
        made = PolicySource(checkpoint=path).build(config)
        assert isinstance(made, RiskPolicy)
        rows.append(play(env, made, 3))
    ours, theirs = (EpisodeRisks.pop(row) for row in rows)
    assert ours is not None
    assert theirs is not None
    assert ours.sign == theirs.sign
    assert np.array(ours.told) == pytest.approx(np.array(theirs.told), abs=1e-4)
    assert len(ours.told) == rows[0]["decisions"]


@pytest.mark.parametrize("record", [False, True])
def test_an_evaluation_records_the_risk_of_each_decision(risky_run: Path, record: bool) -> None:
    source = PolicySource(checkpoint=risky_run / checkpoint.BEST)
    found = EpisodeRunner(EnvConfig(terrain="step"), source, 0, record=record).play(0)
    risks = EpisodeRisks.pop(dict(found))
    assert risks is not None
    assert len(risks.told) == found["decisions"]
    assert risks.to_row().items() <= found.items()


def row(outcome: Outcome, told: list[float]) -> Row:
    return {"outcome": str(outcome), **EpisodeRisks.of(RiskSign(5, 0.5), told).to_row()}


def test_the_threshold_allows_the_share_of_false_alarms() -> None:
    rows = [row(Outcome.REACHED, [0.01, 0.1 + 0.05 * i, 0.01]) for i in range(10)]
    rows += [row(Outcome.STUCK, [0.01] * 4 + [0.9] * 5)]
    found = calibrated(rows, Agent(risk_horizon=5, risk_false_alarms=0.2))
    assert found is not None
    metrics = found[1]
    assert (metrics["risk_reached"], metrics["risk_failures"]) == (10, 1)
    assert (metrics["risk_false_alarms"], metrics["risk_announced"]) == (2, 1)
    assert metrics["risk_false_warnings"] == pytest.approx(2 / 30)
    assert not any("risks" in one for one in rows)  # so that no mean is taken over them


def test_rows_without_risks_have_no_calibration() -> None:
    assert calibrated([{"outcome": "reached"}], Agent()) is None


def test_the_calibration_recovers_a_slope_and_a_shift() -> None:
    rng = np.random.default_rng(0)
    odds = rng.normal(0, 2, 40_000)
    came = (rng.random(40_000) < 1 / (1 + np.exp(-(0.5 * odds - 1.0)))).astype(np.float64)
    slope, shift = fit(odds, came, horizon=5)
    assert slope == pytest.approx(0.5, abs=0.03)
    assert shift == pytest.approx(-1.0, abs=0.05)


def test_a_validation_without_failures_moves_the_calibration_a_little_and_keeps_the_order() -> None:
    for odds in (np.full(400, -9.0), np.full(400, 3.0), np.zeros(1)):
        for came in (0.0, 1.0):
            slope, shift = fit(odds, np.full(len(odds), came), horizon=10)
            assert 0.05 < slope < 10
            assert math.isfinite(shift)
    slope, shift = fit(np.full(400, -9.0), np.zeros(400), horizon=10)
    assert (slope, shift) == pytest.approx((1.0, -math.log(5)), abs=0.05)
