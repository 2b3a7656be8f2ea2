"""A training with a risk: how it is calibrated, and that it and its escapes reach every file."""

import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from flipperctl import checkpoint
from flipperctl.api import FailureRisk, Outcome
from flipperctl.config import EnvConfig
from flipperctl.core.risk import EscapeRule, RiskSign
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, PolicyError
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.export import policy
from flipperctl.policies.source import PolicySource
from flipperctl.policies.trained import policy_risk
from flipperctl.rollout.episode import Decision, Row, play
from flipperctl.rollout.risks import EpisodeRisks
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import read_interface
from flipperctl.training.validation import calibrated, fit

pytestmark = pytest.mark.slow

STEP = EnvConfig(terrain="step")


@pytest.fixture(scope="module")
def risky(runs: Callable[[str], Path]) -> Path:
    return runs("noisy")


@pytest.fixture(scope="module")
def escaping(risky: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The best policy of the run, which warns of anything."""
    folder = tmp_path_factory.mktemp("escaping")
    shutil.copytree(risky, folder, dirs_exist_ok=True)
    best = checkpoint.read(folder / checkpoint.BEST)
    assert best.document.validation is not None
    best.document.validation.__pydantic_extra__["risk_threshold"] = 1e-6
    checkpoint.write(folder / checkpoint.BEST, best.document, best.tensors)
    return folder / checkpoint.BEST


@pytest.fixture(scope="module")
def exported(escaping: Path) -> Path:
    file = escaping.parent / "p.onnx"
    found = policy.export(checkpoint.read(escaping), file)
    assert found["largest_risk_difference"] < 1e-4
    return file


def test_each_validation_calibrates_the_risk_and_the_checkpoint_has_the_numbers(
    risky: Path,
) -> None:
    best = checkpoint.read(risky / checkpoint.BEST)
    assert best.document.validation is not None
    found = best.document.validation.__pydantic_extra__
    assert found["risk_reached"] + found["risk_failures"] == 2
    assert found["risk_announced"] <= found["risk_failures"]
    risk, last = policy_risk(best), policy_risk(checkpoint.read(risky / checkpoint.LAST))
    assert risk is not None
    assert last is not None
    assert risk.sign == RiskSign(8, found["risk_threshold"])
    assert last.sign.horizon == 8


def test_a_policy_with_a_risk_needs_the_learner_which_states_its_escape(
    escaping: Path, registry: dict
) -> None:
    del registry["agent", "d3qn"]
    with pytest.raises(CheckpointError, match=r"there is no agent plugin 'd3qn'"):
        checkpoint.read(escaping).policy_config()


def test_a_checkpoint_without_the_weights_of_its_risk_is_refused(risky: Path) -> None:
    best = checkpoint.read(risky / checkpoint.BEST)
    del best.tensors["risk.layers.0.weight"]
    with pytest.raises(CheckpointError, match=r"its risk is not valid: layers\.0\.weight is miss"):
        policy_risk(best)


def driven(source: PolicySource) -> tuple[list[int], Row]:
    """Return the actions and the row of an episode."""
    made, found = source.build(STEP), list[Decision]()
    row = play(FlipperEnv(config=STEP), made, 3, watch=found.append)
    return [decision.action for decision in found], row


def test_the_exported_file_draws_and_tells_what_the_checkpoint_does(
    escaping: Path, exported: Path
) -> None:
    session = onnxruntime.InferenceSession(exported, providers=["CPUExecutionProvider"])
    outputs = [one.name for one in session.get_outputs()]
    assert outputs == ["q_values", "risk", "risk_recurrence"]
    assert OnnxPolicy(exported).interface.escape == EscapeRule(0.5, 3)
    (ours, row), (theirs, other) = (driven(PolicySource(f)) for f in (escaping, exported))
    assert ours == theirs
    risks, told = EpisodeRisks.pop(row), EpisodeRisks.pop(other)
    assert risks is not None
    assert told is not None
    assert risks.sign == told.sign
    assert np.array(risks.values) == pytest.approx(np.array(told.values), abs=1e-4)
    assert len(risks.values) == row["decisions"]
    greedy = [
        driven(PolicySource(settings={"name": "greedy", "policy": str(file)}))[0]
        for file in (escaping, exported)
    ]
    assert greedy[0] == greedy[1] != ours  # by the same values, but nothing is drawn


def test_an_evaluation_records_the_risk_of_each_decision(risky: Path) -> None:
    source = PolicySource(checkpoint=risky / checkpoint.BEST)
    found = EpisodeRunner(STEP, source, 0, record=True).play(0)
    risks = EpisodeRisks.pop(dict(found))
    assert risks is not None
    assert len(risks.values) == found["decisions"]
    assert risks.to_row().items() <= found.items()


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ('{"temperature": 0, "decisions": 3}', "temperature"),
        ('{"temperature": 1}', "temperature"),
        ('{"temperature": 1, "decisions": 0}', "temperature"),
        (None, r"beside flipperctl\.risk"),
    ],
)
def test_an_escape_that_is_not_possible_is_refused(
    exported: Path, entry: str | None, text: str
) -> None:
    metadata = dict(OnnxPolicy(exported)._session.get_modelmeta().custom_metadata_map)
    if entry is None:
        del metadata["flipperctl.risk"]
    else:
        metadata["flipperctl.escape"] = entry
    with pytest.raises(PolicyError, match=rf"p\.onnx: flipperctl\.escape is .*{text}"):
        read_interface(metadata, "p.onnx")


def row(outcome: Outcome, told: list[float]) -> Row:
    return {"outcome": str(outcome), **EpisodeRisks.of(RiskSign(5, 0.5), told).to_row()}


def test_the_threshold_allows_the_share_of_false_alarms() -> None:
    rows = [row(Outcome.REACHED, [0.01, 0.1 + 0.05 * i, 0.01]) for i in range(10)]
    rows += [row(Outcome.STUCK, [0.01] * 4 + [0.9] * 5)]
    found = calibrated(rows, FailureRisk(5, 0.2, None))
    assert found is not None
    metrics = found[1]
    assert (metrics["risk_reached"], metrics["risk_failures"]) == (10, 1)
    assert (metrics["risk_false_alarms"], metrics["risk_announced"]) == (2, 1)
    assert metrics["risk_false_warnings"] == pytest.approx(2 / 30)
    assert not any("risks" in one for one in rows)  # so that no mean is taken over them
    assert calibrated([{"outcome": "reached"}], FailureRisk(5, 0.2, None)) is None


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
