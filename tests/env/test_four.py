"""Four flippers that turn alone: in 3-D, in observations, in networks, and on a robot."""

from pathlib import Path

import numpy as np
import pytest
import torch

from flipperctl import checkpoint
from flipperctl.agent.losses import double_q_target
from flipperctl.agent.networks import Branches
from flipperctl.api import ACTIONS
from flipperctl.checkpoint import recording
from flipperctl.config import EnvConfig, Teacher
from flipperctl.core.targets import actions_of, of_pairs
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.evaluation.rows import RECORDED
from flipperctl.export.policy import export
from flipperctl.policies.controllers import DaggerPolicy
from flipperctl.policies.greedy import Greedy
from flipperctl.policies.source import ExportedPolicy, controller_policy, load_policy
from flipperctl.rollout.episode import decisions
from flipperctl.training.episodes import EPISODES
from flipperctl.training.trainer import Trainer
from tests.played import play_episodes
from tests.short import few

FOUR = {"sim": "mujoco", "robot": {"flippers": "four"}}


def test_each_flipper_turns_alone_and_is_perceived() -> None:
    env = FlipperEnv("uplift", **FOUR, perception={"sides": True})
    observation, _ = env.reset(seed=1)
    assert (observation.shape, env.action_space.n) == ((96,), 81)  # type: ignore[attr-defined]
    step = env.robot.angle_step
    observation, *_ = env.step(actions_of(4).index((-1, 1, -1, 0)))
    expected = [-step, step, -step, 0.0]
    assert env.drive.targets == pytest.approx(expected)
    assert env.state.flippers == pytest.approx(expected, abs=0.08)  # under load
    assert observation[-5:-1] == pytest.approx(env.state.flippers, abs=1e-6)
    assert (env.state.front, env.state.rear) == pytest.approx((0.0, -step / 2), abs=0.08)
    assert env.state.roll > 0.02  # it stands on the lowered flippers of its left
    # Rates of all joints
    env.step((1.0, -0.5, 0.0, -0.25))
    assert env.transition.action == (1, 0, 0, 0)
    assert env.drive.targets == pytest.approx([0.0, step / 2, -step, -step / 4], abs=0.08)


def test_a_rule_of_pairs_drives_both_sides_alike() -> None:
    def digest(**more: object) -> list[list[float]]:
        env = FlipperEnv("uplift", sim="mujoco", **more)
        policy = load_policy("okada").build(env.config)
        return [d.poses[-1, :3].tolist() for d in decisions(env, policy, 3)]

    assert digest(robot={"flippers": "four"}) == digest()


def test_the_side_plane_refuses_four() -> None:
    with pytest.raises(ConfigError, match="sim=planar moves pairs alone, not four"):
        FlipperEnv("uplift", robot={"flippers": "four"})


def test_branches_have_the_targets_of_their_paper() -> None:
    # Tavakoli et al. 2018, Eq. 1: one V, and advantages of each side less their mean
    rng = np.random.default_rng(0)
    value, advantages = rng.normal(size=5), rng.normal(size=(2, 5, 2, 9))
    dueling = value[:, None, None] + advantages - advantages.mean(axis=3, keepdims=True)
    # A head that subtracts the mean of all 18, as Dueling does, gives the same
    heads = advantages - advantages.mean(axis=(2, 3), keepdims=True) + value[:, None, None]
    online, target = (Branches(torch.nn.Flatten())(torch.tensor(h)) for h in heads)
    assert online.shape == (5, 81)
    # Eq. 6: the mean over sides of the target's values of the best turns online
    reward, discount = rng.normal(size=5), rng.random(5)
    best = dueling[0].argmax(axis=2)
    after = np.take_along_axis(dueling[1], best[:, :, None], axis=2)[:, :, 0].mean(axis=1)
    targets = double_q_target(torch.tensor(reward), torch.tensor(discount), online, target)
    assert targets.tolist() == pytest.approx((reward + discount * after).tolist())
    turns = np.array(actions_of(4))[online.argmax(dim=1)].reshape(5, 2, 2)
    assert (turns.transpose(0, 2, 1) == np.array(ACTIONS)[best]).all()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["turns", "rates"])
def test_a_training_of_four_drives_equally_from_its_file(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("stable_baselines3")
    agent = {"name": "sb3", "algorithm": "sac", "settings": {"learning_starts": 50}}
    rates = {"agent": agent, "actions": "rates", "network": {"name": "mlp"}}
    config = few(
        **{**FOUR, "perception": {"sides": True}, "train.decisions": 120},
        **(rates if kind == "rates" else {}),
    )
    (tmp_path / checkpoint.BEST.parent).mkdir(parents=True)
    Trainer(config, tmp_path).run()
    saved, file = checkpoint.read(tmp_path / checkpoint.BEST), tmp_path / "four.onnx"
    export(saved, file)
    source = load_policy(str(file))
    assert source.config().environment().robot == config.robot
    exported = ExportedPolicy(file)
    env = FlipperEnv(config=config.environment(), actions=config.actions)
    for decision in decisions(env, load_policy(str(tmp_path)).build(env.config), 7):
        action = decision.action if decision.rates is None else decision.rates
        assert exported.act(decision.perception) == action
    assert exported.interface.joints[0] == "front_left"
    # The controller greedy, of a file with Q-values, turns as it does
    if kind == "turns":
        greedy = Greedy(policy=str(tmp_path))
        policy = controller_policy(greedy, env.config)
        env.reset(seed=7)
        policy.reset(env.simulator())
        for _ in range(3):
            index, rates = exported.act(env.perception), policy.act(env.perception)
            assert isinstance(index, int)
            assert rates == actions_of(4)[index]
            env.step(rates)


def test_recorded_episodes_of_four_teach_turns_of_each_side(tmp_path: Path) -> None:
    words = {**FOUR, "sim": {"name": "mujoco", "one_sided": 1}, "perception": {"sides": True}}
    config, source = EnvConfig(terrain="step", **words), load_policy("okada_sides")
    played = play_episodes(config, source, episodes=2, seed=5, record=True)
    file = tmp_path / "sides.safetensors"
    recording.write(file, "okada_sides", [(config, [row[RECORDED] for row in played])])
    again = recording.read(file)
    for row, episode in zip(played, again.episodes, strict=True):
        assert np.array_equal(episode.actions, row[RECORDED].actions)
        assert episode.labels.shape == (len(episode.actions), 81)
        assert (episode.labels.argmax(1) == episode.actions).all()
    turns = np.array(actions_of(4))[np.concatenate([e.actions for e in again.episodes])]
    assert (turns[:, 0] != turns[:, 1]).any()
    # The same episodes without a record, and a training that learns from them and records its own
    unrecorded = play_episodes(config, source, episodes=2, seed=5)
    assert [row["digest"] for row in unrecorded] == [row["digest"] for row in played]
    alone = {"teacher.episodes": str(file), "teacher.td_weight": 0.0, "train.decisions": 60}
    run = few(**words, **alone, **{"train.record": True, "train.validation_episodes": 1})
    (tmp_path / checkpoint.BEST.parent).mkdir(parents=True)
    trainer = Trainer(run, tmp_path)
    trainer.run()
    label = checkpoint.read(tmp_path / checkpoint.LAST).part("replay")["label"][: again.decisions]
    assert label.argmax(1).tolist() == [a for e in again.episodes for a in e.actions.tolist()]
    assert recording.read(tmp_path / EPISODES).episodes[0].labels.shape[1] == 81


@pytest.mark.parametrize("teacher", ["okada", "mpc"])
def test_a_teacher_of_pairs_labels_turns_of_both_sides_alike(teacher: str) -> None:
    small = {"value": "", "beam": 2, "horizon": 2} if teacher == "mpc" else {}
    settings = Teacher(controller={"name": teacher, **small}, privileged=True, random=0.5)
    env = FlipperEnv("uplift", **FOUR)
    assert settings.controller is not None
    acting = controller_policy(settings.controller, env.config)
    student = load_policy("level").build(env.config)
    policy = DaggerPolicy(student, acting, settings, lambda: False, np.random.default_rng(0))
    alike, actions = [of_pairs(action, 4) for action in range(len(ACTIONS))], set()
    for number, decision in enumerate(decisions(env, policy, 3)):
        assert policy.label.shape == (81,)
        assert policy.label[alike].sum() == pytest.approx(1)
        actions.add(decision.action)
        if number == 8:
            break
    assert actions - set(alike)  # random ones turn the sides apart
