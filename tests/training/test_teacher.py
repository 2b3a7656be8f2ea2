"""Training with a teacher: its labels, who drives, and runs that repeat and resume bit for bit."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from flipperctl import checkpoint
from flipperctl.api import Perception, Simulator
from flipperctl.config import EnvConfig, Teacher, resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import ConfigError
from flipperctl.policies.controllers import DaggerPolicy, plugin_policy
from flipperctl.policies.trained import policy_module
from flipperctl.rollout.episode import decisions
from tests.short import short_config, trainer

pytestmark = pytest.mark.slow

OKADA = {"teacher.controller": {"name": "okada"}}


class _Student:
    """Takes action 8 always."""

    def reset(self, simulator: Simulator) -> None:
        pass

    def act(self, p: Perception) -> int:
        return 8


class _Half(_Student):
    """Chooses action 8 at random, and says so, else 0."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self.explored = rng, False

    def act(self, p: Perception) -> int:
        self.explored = bool(self._rng.random() < 0.5)
        return 8 * self.explored


def drive(settings: Teacher, *, learns: bool = True, count: int = 10) -> list[tuple[int, int]]:
    """Return the action taken and the teacher's most probable one at each decision."""
    assert settings.controller is not None
    policy = DaggerPolicy(
        *(_Student(), plugin_policy(settings.controller), settings),
        *(lambda: learns, np.random.default_rng(0)),
    )
    found = []
    for decision in decisions(FlipperEnv("step"), policy, 1):
        found.append((decision.action, int(policy.label.argmax())))
        assert policy.label.sum() == pytest.approx(1)
        if len(found) == count:
            break
    return found


@pytest.mark.parametrize("name", ["okada", "mpc"])
def test_the_teacher_labels_what_the_student_drives(name: str) -> None:
    controller = resolver.reference(name, "teacher")
    driven = drive(Teacher(controller=controller, student_share=1))
    assert {action for action, _ in driven} == {8}
    assert any(label != 8 for _, label in driven)


def test_the_teacher_drives_the_other_episodes_and_all_before_the_student_learns() -> None:
    for settings, learns in (({"student_share": 0}, True), ({"student_share": 1}, False)):
        driven = drive(Teacher(controller="okada", random=0, **settings), learns=learns)
        assert all(action == label for action, label in driven)


def shared_labels(share: float, student: float, count: int = 40) -> NDArray[np.float32]:
    """Return the labels of the first decisions of an episode, (count, 9)."""
    mpc = {"name": "mpc", "value": "", "beam": 4, "horizon": 2}
    settings = Teacher(
        controller=mpc, random=0, student_share=student, label_share=share, privileged=True
    )
    assert settings.controller is not None
    policy = DaggerPolicy(
        *(_Half(np.random.default_rng(1)), plugin_policy(settings.controller), settings),
        *(lambda: True, np.random.default_rng(0)),
    )
    driven = decisions(FlipperEnv("building_stair"), policy, 1)
    return np.array([policy.label for _ in islice(driven, count)])


def test_fewer_labels_are_those_of_the_same_states() -> None:
    """The teacher follows what it does not label: its ground, its targets, its standing."""
    every, some = shared_labels(1.0, student=1), shared_labels(0.3, student=1)
    labelled = some.sum(axis=1) > 0
    assert 5 <= labelled.sum() <= 20
    assert (some[~labelled] == 0).all()
    # A plan for which no former one was kept differs by what the former one adds to a search.
    assert np.abs(every - some)[labelled].mean() < 0.01
    assert np.abs(every[1:] - every[:-1]).mean() > 0.04  # far less than one decision matters


def test_a_teacher_that_cannot_follow_is_refused_with_fewer_labels() -> None:
    with pytest.raises(ConfigError, match=r"teacher\.label_share: 0\.5 .* such as mpc; 1 is"):
        drive(Teacher(controller="okada", label_share=0.5))


def test_random_actions_of_teacher_and_student_are_reported() -> None:
    env, rng = FlipperEnv("step"), np.random.default_rng(0)
    for share in (0.0, 1.0):
        settings = Teacher(controller="okada", student_share=share, random=0.5)
        assert settings.controller is not None
        policy = DaggerPolicy(
            *(_Half(rng), plugin_policy(settings.controller), settings), *(lambda: True, rng)
        )
        found = []
        for decision in decisions(env, policy, 1):
            random = decision.action == 8 if share else decision.action != policy.label.argmax()
            found.append((policy.explored, random))
        assert {explored for explored, _ in found} == {False, True}
        assert all(explored for explored, random in found if random)


def test_a_privileged_teacher_perceives_exactly_what_the_student_drives() -> None:
    """Its labels are those of the same states without noise, delay and horizon."""
    poor = {"noise": 0.05, "delay": 0.3, "horizon": 0.3, "pitch_bias": 0.1}
    rough = EnvConfig(terrain="step", perception={"name": "planar", **poor})

    def labels(config: EnvConfig, **settings: bool) -> NDArray[np.float64]:
        mpc = {"name": "mpc", "value": "", "friction": 1.0}  # that a privileged teacher is told
        teacher = Teacher(controller=mpc, student_share=1, **settings)
        policy = DaggerPolicy(
            *(_Student(), plugin_policy(teacher.controller), teacher),
            *(lambda: True, np.random.default_rng(0)),
        )
        driven = islice(decisions(FlipperEnv(config=config), policy, 1), 8)
        return np.array([policy.label for _ in driven])

    exact = labels(EnvConfig(terrain="step"))
    np.testing.assert_array_equal(labels(rough, privileged=True), exact)
    assert np.abs(labels(rough) - exact).max() > 0.1


def test_a_teacher_that_plans_whole_episodes_labels_only_its_own() -> None:
    with pytest.raises(ConfigError, match=r"set teacher\.student_share=0 and teacher\.random=0"):
        Teacher(controller="planner")
    assert Teacher(controller="planner", student_share=0, random=0).controller is not None
    with pytest.raises(ConfigError, match=r"teacher\.td_weight: 0 needs"):
        Teacher(controller="okada", td_weight=0, weight_end=0)
    with pytest.raises(ConfigError, match=r"teacher\.episodes: the name of a file is needed"):
        Teacher(episodes="")


def test_imitation_alone_learns_what_a_rule_does(tmp_path: Path) -> None:
    alone = {"teacher.td_weight": 0.0, "agent.epsilon_start": 0.1}
    rule = {"teacher.controller": {"name": "okada_published"}}  # moves both pairs by one angle
    config = short_config(**rule, **alone, **{"train.validation_episodes": 5})
    summary = trainer(config, tmp_path).run()
    assert summary["best"]["success_rate"] >= 0.8  # 0 % to 20 % without a teacher, of 600
    last = checkpoint.read(tmp_path / checkpoint.LAST)
    observations = last.part("replay")["observation"][:200]
    values = policy_module(last)(observations.reshape(len(observations), -1))
    assert float(values.mean(dim=1).abs().max()) < 1.0
