"""Every network can be trained, evaluated and exported by its name alone."""

from collections.abc import Callable
from pathlib import Path

import onnxruntime
import pytest

from flipperctl import checkpoint
from flipperctl.agent.risk import weights_of
from flipperctl.config import EnvConfig, to_dict
from flipperctl.export import policy as export_policy
from flipperctl.learners.double_q import DoubleQ
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.collect import Actor
from flipperctl.rollout.episode import RolloutRequest
from flipperctl.runtime import OnnxPolicy
from tests.played import play_episodes
from tests.training.conftest import setup

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    ["quantile", *(pytest.param(n, marks=pytest.mark.long) for n in ("conv", "stacked", "noisy"))],
)
def test_the_exported_policy_acts_as_the_trained_one(
    name: str, runs: Callable[[str], Path], tmp_path: Path
) -> None:
    best = runs(name) / checkpoint.BEST
    saved, path = checkpoint.read(best), tmp_path / "policy.onnx"
    assert export_policy.export(saved, path)["action_agreement"] == 1.0
    frames = saved.config().network.frames
    assert OnnxPolicy(path).interface.frames == frames
    (entry,) = onnxruntime.InferenceSession(path).get_inputs()[:1]
    assert entry.shape[1] == saved.config().perception.layout.size * frames
    scene = EnvConfig(terrain="step")
    ours, theirs = (
        [{k: v for k, v in row.items() if k != "risks"} for row in played]
        for played in (
            play_episodes(scene, PolicySource(file), episodes=2, seed=1) for file in (best, path)
        )
    )
    assert ours == theirs


@pytest.mark.parametrize("name", ["noisy", "stacked"])
def test_workers_use_several_frames_and_repeatable_noise(name: str) -> None:
    settings = setup(
        name, **{"agent.exploring_share": 1.0, "agent.epsilon_start": 0.0, "agent.epsilon_end": 0.0}
    )
    network, layout = settings.network, settings.perception
    weights = weights_of(DoubleQ(network, layout, settings.agent, seed=1).online)
    actors = [Actor(to_dict(settings)) for _ in range(2)]
    requests = [RolloutRequest(episode, 5, 0, 0, {}) for episode in (0, 1)]
    actors[1].evaluate(weights, 3)  # must not change the next rollout
    one, again, other = (
        actor.play(request, weights)
        for actor, request in zip(
            [*actors, actors[0]], [*requests[:1] * 2, requests[1]], strict=True
        )
    )
    assert one[0].observation.shape == (network.frames * layout.size,)
    actions = [[step.action for step in made] for made in (one, again, other)]
    assert actions[0] == actions[1]
    # Without random actions, only noise makes two episodes of equal terrain differ; dropout
    # is of the updates alone.
    assert (actions[0] == actions[2]) == (name == "stacked")
