"""Every network can be trained, evaluated and exported by its name alone."""

from pathlib import Path

import onnxruntime
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.api import Network
from flipperctl.api.plugin import registered_names
from flipperctl.config import EnvConfig, TrainConfig
from flipperctl.export import policy as export_policy
from flipperctl.policies.source import PolicySource
from flipperctl.runtime import OnnxPolicy
from tests.played import play_episodes
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

NEW = [n for n in registered_names("network") if n not in ("at_d3qn", "dueling_mlp", "mlp")]


def config(name: str, **more: object) -> TrainConfig:
    """Return the configuration of a training of some twelve episodes."""
    quick = {
        "train.decisions": 260,
        "train.validate_every": 130,
        "train.validation_episodes": 1,
        "agent.learning_starts": 60,
        "agent.batch_size": 32,
        "agent.epsilon_start": 0.2,
        **more,
    }
    network = {"name": name, "dropout": 0.1} if name == "stacked" else name
    return short_config(network=network, **quick)


@pytest.fixture(scope="module", params=NEW)
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the directory of a finished run of one of the networks."""
    folder = tmp_path_factory.mktemp(request.param)
    summary = trainer(config(request.param), folder).run()
    assert summary["network"] == request.param
    return folder


@pytest.mark.parametrize("trained", ["noisy", "stacked"], indirect=True)
def test_a_resumed_run_equals_the_uninterrupted_one(trained: Path, tmp_path: Path) -> None:
    whole = checkpoint.read(trained / checkpoint.LAST)
    first = trainer(whole.config(), tmp_path)
    first.run(stop=lambda: first.progress.decision >= 120)
    stopped = checkpoint.read(tmp_path / checkpoint.LAST)
    assert 0 < stopped.document.state.updates < whole.document.state.updates
    second = trainer(stopped.config(), tmp_path)
    second.restore(stopped)
    second.run()
    resumed = checkpoint.read(tmp_path / checkpoint.LAST)
    assert resumed.tensors.keys() == whole.tensors.keys()
    for name, tensor in whole.tensors.items():
        assert torch.equal(resumed.tensors[name], tensor), name
    for key in ("validations", "generators"):
        assert getattr(resumed.document.state, key) == getattr(whole.document.state, key)


def test_the_exported_policy_acts_as_the_trained_one(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(export_policy, "OBSERVATIONS", 100)
    saved, path = checkpoint.read(trained / checkpoint.BEST), tmp_path / "policy.onnx"
    for found in (
        export_policy.export(saved, "onnx", path),
        export_policy.export(saved, "pt2", tmp_path / "policy.pt2"),
    ):
        assert found["action_agreement"] == 1.0
    frames = saved.config().network.frames
    assert OnnxPolicy(path).interface.frames == frames
    (entry,) = onnxruntime.InferenceSession(path).get_inputs()
    assert entry.shape[1] == 18 * frames
    scene = EnvConfig(terrain="step")
    expected = list(
        play_episodes(scene, PolicySource(trained / checkpoint.BEST), episodes=3, seed=1)
    )
    assert play_episodes(scene, PolicySource(path), episodes=3, seed=1) == expected


def test_workers_use_several_frames_and_repeatable_noise(tmp_path: Path) -> None:
    from flipperctl.agent.d3qn import D3qn
    from flipperctl.agent.learner import arrays
    from flipperctl.config import to_dict
    from flipperctl.rollout.actor import Actor
    from flipperctl.rollout.steps import RolloutRequest

    for name in ("noisy", "stacked"):
        settings = config(name)
        network, layout = settings.network, settings.perception
        assert isinstance(network, Network)
        agent = D3qn(network, layout, 9, settings.agent, seed=1)
        weights = arrays(agent.online)
        actors = [Actor(to_dict(settings), []) for _ in range(2)]
        requests = [RolloutRequest(episode, 5, 0.0, 0, 0, {}) for episode in (0, 1)]
        actors[1].evaluate(weights, 3)  # must not change the next rollout
        one, again, other = (
            actor.play(request, weights)
            for actor, request in zip(
                [*actors, actors[0]], [*requests[:1] * 2, requests[1]], strict=True
            )
        )
        assert one[0].observation.shape == (network.frames * layout.size,)
        assert [step.action for step in one] == [step.action for step in again]
        # Without random actions, only noise makes two episodes of equal terrain differ; dropout
        # is of the updates alone.
        same = [step.action for step in one] == [step.action for step in other]
        assert same == (name == "stacked")
