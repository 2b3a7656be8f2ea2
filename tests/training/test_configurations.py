"""A few random configurations; ``python -m tests.long.configurations`` trains a thousand."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from tests.configurations import Overrides, attempt, command, left_out, overrides
from tests.long.configurations import report

pytestmark = pytest.mark.slow


@settings(
    max_examples=12,
    phases=[Phase.generate],  # a smaller case of a fault takes minutes to find
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
@given(drawn=overrides())
def test_a_configuration_trains_or_is_refused_by_name(drawn: Overrides) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = attempt(drawn, Path(folder) / "run")
    assert found.kind in ("trained", "refused"), f"{found.text}\n{command(drawn)}"


def test_a_wrong_setting_is_refused_and_a_fault_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    refused = attempt({"agent.gamma": 1.0}, tmp_path / "refused")
    assert (refused.kind, refused.section) == ("refused", "agent")
    trained = attempt({"agent.n_step": 10, "agent.learning_starts": 1}, tmp_path / "trained")
    assert trained.kind == "trained"
    assert report([refused, trained]) == 0
    monkeypatch.setattr("flipperctl.agent.replay.Replay.sample", lambda *_: 1 / 0)
    faulty = attempt({}, tmp_path / "faulty")
    assert faulty.kind == "fault"
    assert "ZeroDivisionError at test_configurations.py" in faulty.text
    assert report([refused, trained, faulty]) == 1
    assert "fault                        1" in capsys.readouterr().out


def test_settings_of_every_type_are_drawn() -> None:
    assert left_out() == []


def test_a_command_says_how_to_reproduce_a_configuration() -> None:
    drawn = {
        "terrain": {"name": "stair"},
        "rewards.travel": {"name": "travel"},
        "rewards.end": None,
        "agent.bootstrap_outcomes": ["stuck"],
    }
    words = command(drawn)
    assert words.startswith("flipperctl train train.mode=exact train.decisions=60 ")
    assert words.endswith(
        "terrain=stair +reward@rewards.travel=travel ~rewards.end "
        "'agent.bootstrap_outcomes=['stuck']'"
    )
