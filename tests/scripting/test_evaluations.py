"""``flipperctl.evaluate`` on suites, and what is left of one that failed or was stopped."""

import os
import signal
from pathlib import Path

import pytest

import flipperctl
from flipperctl import api
from flipperctl.errors import FlipperctlError, InterruptedRunError

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


def test_a_suite_is_played_as_by_the_command(tmp_path: Path) -> None:
    suite = tmp_path / "mine.yaml"
    suite.write_text("scenes:\n  dry: terrain=flat\n  wet: terrain=flat sim.friction=0.5\n")
    asked = {"episodes": 1, "progress": False}
    for given in ({"overrides": [f"suite={suite}"]}, {"suite": suite}):
        found = flipperctl.evaluate("okada", **given, **asked)
        rows = [(scene["suite_scene"], scene["controller"]) for scene in found.scenes]
        assert rows == [(name, who) for name in ("dry", "wet") for who in ("okada", "level")]
    alone = flipperctl.evaluate("okada", suite=str(suite), baselines=[], **asked)
    assert [scene["suite_scene"] for scene in alone.scenes] == ["dry", "wet"]


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


def test_a_picture_that_cannot_be_written_loses_no_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*given: object, **named: object) -> None:
        raise FlipperctlError("no space left")

    monkeypatch.setattr("flipperctl.evaluation.pictures.film_scene", full)
    with pytest.raises(FlipperctlError, match="no space left") as raised:
        flipperctl.evaluate("level", baselines=[], episodes=1, film=tmp_path / "a.gif", **ONE)
    assert len(raised.value.result.scenes) == 1
