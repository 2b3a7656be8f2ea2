"""A policy that escapes: what its training asks for, and that its exported file does the same."""

from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.config import EnvConfig, TrainConfig, with_overrides
from flipperctl.core.risk import EscapeRule
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import CheckpointError, ConfigError, PolicyError
from flipperctl.export import policy
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, play
from flipperctl.runtime import OnnxPolicy
from flipperctl.runtime.interface import read_interface
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

RULE = EscapeRule(0.5, 3)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("escaping")
    settings = {
        "agent.risk": True,
        "agent.escape_temperature": RULE.temperature,
        "agent.escape_decisions": RULE.decisions,
    }
    trainer(short_config(**settings), folder).run()
    best = checkpoint.read(folder / checkpoint.BEST)
    assert best.document.validation is not None
    best.document.validation.__pydantic_extra__["risk_threshold"] = 1e-6  # it warns of anything
    checkpoint.write(folder / checkpoint.BEST, best.document, best.tensors)
    return folder


@pytest.fixture(scope="module")
def exported(run: Path) -> Path:
    file = run / "p.onnx"
    policy.export(checkpoint.read(run / checkpoint.BEST), "onnx", file)
    return file


def actions(source: PolicySource) -> list[int]:
    config, found = EnvConfig(terrain="step"), list[Decision]()
    play(FlipperEnv(config=config), source.build(config), 3, watch=found.append)
    return [decision.action for decision in found]


def test_the_exported_file_draws_what_the_checkpoint_draws(run: Path, exported: Path) -> None:
    assert OnnxPolicy(exported).interface.escape == RULE
    ours = actions(PolicySource(checkpoint=run / checkpoint.BEST))
    assert actions(PolicySource(checkpoint=exported)) == ours


def test_the_controller_greedy_drives_by_the_same_values_and_draws_nothing(
    run: Path, exported: Path
) -> None:
    best = run / checkpoint.BEST
    ours, theirs = (
        actions(PolicySource(settings={"name": "greedy", "policy": str(file)}))
        for file in (best, exported)
    )
    assert ours == theirs
    assert ours != actions(PolicySource(checkpoint=best))


@pytest.mark.parametrize(
    "entry",
    [
        '{"temperature": 0, "decisions": 3}',
        '{"temperature": 1}',
        '{"temperature": 1, "decisions": 0}',
    ],
)
def test_an_escape_that_is_not_possible_is_refused(exported: Path, entry: str) -> None:
    metadata = OnnxPolicy(exported)._session.get_modelmeta().custom_metadata_map
    with pytest.raises(PolicyError, match=r"p\.onnx: flipperctl\.escape is .*temperature"):
        read_interface({**metadata, "flipperctl.escape": entry}, "p.onnx")


def test_an_escape_without_a_risk_is_refused(exported: Path) -> None:
    metadata = OnnxPolicy(exported)._session.get_modelmeta().custom_metadata_map
    without = {name: text for name, text in metadata.items() if name != "flipperctl.risk"}
    with pytest.raises(PolicyError, match=r"flipperctl\.escape is .* beside flipperctl\.risk"):
        read_interface(without, "p.onnx")


def test_an_escape_needs_a_risk() -> None:
    base = TrainConfig(terrain="step", network="at_d3qn")
    with pytest.raises(ConfigError, match=r"agent\.escape_temperature: 0\.1 needs warnings"):
        with_overrides(base, {"agent.escape_temperature": 0.1})


def test_greedy_needs_a_policy_of_a_file() -> None:
    scene = EnvConfig(terrain="step")
    with pytest.raises(ConfigError, match="policy: '' is no policy of a file"):
        PolicySource(settings={"name": "greedy", "policy": ""}).build(scene)
    with pytest.raises(CheckpointError, match=r"controller\.policy: okada"):
        PolicySource(settings={"name": "greedy", "policy": "okada"}).build(scene)
