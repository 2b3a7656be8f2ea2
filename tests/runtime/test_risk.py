"""The risk of an exported policy on the robot: its probability, its warning and its log."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl.errors import NonFiniteError, PolicyError
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.shadow import Shadow
from tests.runtime.linear import RISK, ROBOT, RULE, write
from tests.runtime.test_shadow import SETUP, messages

FILE: Any = {"robot": ROBOT, "targets": RULE}


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("risky") / "p.onnx"
    return write(path, **FILE, risky=True, risk=RISK)


def seen(height: float) -> np.ndarray:
    """An observation with this first height."""
    return np.array([height] + [0.0] * 17)


def sigmoid(score: float) -> float:
    return 1 / (1 + math.exp(-score))


def test_the_risk_is_that_of_the_observation_and_of_its_recurrence(file: Path) -> None:
    policy = OnnxPolicy(file)
    assert policy.risk is None
    assert not policy.warning
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(0.5), abs=1e-6)  # 0.62, nothing came before
    assert not policy.warning
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(1.0), abs=1e-6)  # 0.73, it repeats
    assert policy.warning
    policy.act(seen(1.04))  # a mean difference of 0.54 / 18, which is the scale
    assert policy.risk == pytest.approx(sigmoid(1.04 + 1.04 / math.e), abs=1e-6)
    policy.reset()
    assert policy.risk is None
    policy.act(seen(0.5))
    assert policy.risk == pytest.approx(sigmoid(0.5), abs=1e-6)


def test_q_values_and_actions_are_those_of_the_file_without_a_risk(
    file: Path, tmp_path: Path
) -> None:
    plain = OnnxPolicy(write(tmp_path / "p.onnx", **FILE))
    policy, heights = OnnxPolicy(file), np.linspace(-1, 1, 18)
    assert policy.q_values(heights).tolist() == plain.q_values(heights).tolist()
    assert policy.act(heights) == plain.act(heights)
    assert plain.risk is None
    assert not plain.warning
    assert plain.interface.risk is None


def test_the_controller_tells_it_and_shadow_mode_logs_it(file: Path, tmp_path: Path) -> None:
    def log(policy: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
        lines: list[str] = []
        shadow = Shadow(policy, SETUP, lambda line: lines.append(str(line)))
        for tick in range(100):
            shadow.take(tick * 0.05, messages(tick * 0.05))
        return list(map(json.loads, lines)), shadow.summary()

    told, summary = log(file)  # level ground 0.15 m below
    decided = [line["risk"] for line in told if line["action"] is not None]
    assert decided[0] == pytest.approx(sigmoid(-0.15), abs=0.002)
    assert decided[-1] == pytest.approx(sigmoid(-0.3), abs=0.01)
    assert not any(line["warning"] for line in told)
    assert summary["warnings"] == 0
    eager = {**RISK, "threshold": 0.4}
    told, summary = log(write(tmp_path / "e.onnx", **FILE, risky=True, risk=eager))
    assert summary["warnings"] == summary["decisions"] == 9
    assert told[-1]["warning"]
    told, summary = log(write(tmp_path / "p.onnx", **FILE))
    assert not {"risk", "warning"} & set(told[0])
    assert "warnings" not in summary


def test_while_the_flippers_are_held_there_is_no_risk(file: Path) -> None:
    lines: list[str] = []
    shadow = Shadow(file, SETUP, lambda line: lines.append(str(line)))
    for tick in range(20):
        shadow.take(tick * 0.05, messages(tick * 0.05))
    shadow.take(1.5, {})  # nothing arrives any more
    last = json.loads(lines[-1])
    assert (last["state"], last["risk"], last["warning"]) == ("holding", None, False)


@pytest.mark.parametrize(
    ("risk", "text"),
    [
        ({**RISK, "threshold": 1.5}, "flipperctl.risk is"),
        ({**RISK, "lags": [1, 2]}, r"the lags \[1, 2, 4, 8, 16\]"),
        ({"horizon": 10}, "flipperctl.risk is"),
    ],
)
def test_metadata_of_a_wrong_risk_are_refused(tmp_path: Path, risk: Any, text: str) -> None:
    with pytest.raises(PolicyError, match=text):
        OnnxPolicy(write(tmp_path / "p.onnx", **FILE, risky=True, risk=risk))


def test_a_risk_and_its_metadata_come_together(tmp_path: Path) -> None:
    for name, (risky, risk) in {"a": (True, None), "b": (False, RISK)}.items():
        with pytest.raises(PolicyError, match="the model has"):
            OnnxPolicy(write(tmp_path / name, **FILE, risky=risky, risk=risk))


def test_a_risk_that_is_no_number_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = OnnxPolicy(write(tmp_path / "p.onnx", **FILE, risky=True, risk=RISK))
    bound = policy._risk
    assert bound is not None
    monkeypatch.setattr(bound, "_alone", np.full((1, 1), np.nan, np.float32))
    with pytest.raises(NonFiniteError, match=r"p\.onnx: the risk is not a finite number"):
        policy.act(seen(0.5))
