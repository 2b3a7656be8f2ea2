"""Trainings that learn from recorded episodes, and trainings that record their own."""

import itertools
import math
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flipperctl import checkpoint
from flipperctl.agent.replay import Replay
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import Recording
from flipperctl.config import EnvConfig, TrainConfig
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.evaluation.rows import RECORDED
from flipperctl.learners.recorded import check_fit, differing_conditions, fill, read_teacher
from flipperctl.policies import controllers
from flipperctl.policies.controllers import DaggerPolicy
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.collect import RolloutWorkers
from flipperctl.training import episodes
from flipperctl.training.episodes import EPISODES, PARTS
from flipperctl.training.folder import clear_leftovers
from flipperctl.training.trainer import Trainer
from tests.played import play_episodes
from tests.rollout.notes import Notes
from tests.short import few, short_config, trainer
from tests.training.conftest import require_resumes

pytestmark = pytest.mark.slow

OKADA = PolicySource(settings={"name": "okada"})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the rule okada does on 10 steps."""
    path = tmp_path_factory.mktemp("recorded") / "okada.safetensors"
    config = EnvConfig(terrain="step")
    found = play_episodes(config, OKADA, episodes=10, seed=5, record=True)
    recording.write(path, "okada", [(config, [e[RECORDED] for e in found])])
    return path


def filled(file: Path, **settings: Any) -> tuple[Replay, Recording]:
    config = short_config(**{"teacher.episodes": str(file), **settings})
    found = read_teacher(config)
    assert found is not None
    size = config.network.frames * config.perception.size
    replay = Replay(5000, size, config.agent.n_step, config.agent.gamma, labels=9)
    fill(replay, found, config)
    return replay, found


def test_recorded_decisions_are_n_step_transitions_with_labels(file: Path) -> None:
    replay, found = filled(file)
    assert replay.added == replay.kept == found.decisions
    first, arrays = found.episodes[0], replay.filled()
    count = len(first.actions)
    assert np.array_equal(arrays["observation"][:count], first.observations[:-1])
    assert np.array_equal(arrays["next_observation"][0], first.observations[3])
    assert np.array_equal(arrays["label"], np.eye(9, dtype=np.float32)[arrays["action"]])
    weighted = first.rewards[:3] @ (1.0, 0.99, 0.99**2)
    assert arrays["reward"][0] == pytest.approx(weighted)
    assert arrays["discount"][0] == pytest.approx(0.99**3)
    assert (arrays["discount"][count - 3 : count] == 0).all()


def test_a_run_with_a_recorded_teacher_resumes_bit_for_bit_without_the_file(
    file: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(file.read_bytes())
    short = {"train.decisions": 160, "train.validate_every": 80}
    config = few(**{"teacher.episodes": str(copy), "teacher.loss": "margin", **short})
    trainer(config, tmp_path / "whole").run()
    require_resumes(config, tmp_path / "whole", tmp_path / "parts", 90)
    saved = checkpoint.read(tmp_path / "whole" / checkpoint.LAST)
    state = saved.document.state
    assert state is not None
    decisions = recording.read(file).decisions
    assert state.learner["kept"] == decisions
    labelled = saved.part("replay")["label"].sum(dim=1)
    assert (labelled[:decisions] == 1).all()  # the recorded ones, and none of the student's
    assert not labelled[decisions:].any()
    copy.unlink()
    resumed = trainer(saved.config(), tmp_path / "later")
    resumed.restore(saved)
    resumed.run()


def test_a_replay_that_learns_from_a_run_is_that_of_the_run(runs: Callable[[str], Path]) -> None:
    folder = runs("taught")
    found = recording.read(folder / EPISODES)
    state = checkpoint.read(folder / checkpoint.LAST).document.state
    assert state is not None
    assert [episode.number for episode in found.episodes] == list(range(state.episode))
    assert all(np.allclose(episode.labels.sum(axis=1), 1) for episode in found.episodes)
    stacking = {"network": {"name": "stacked", "window": 2}, "agent.n_step": 2}
    replay, _ = filled(folder / EPISODES, **stacking)
    own = checkpoint.read(folder / checkpoint.LAST).part("replay")
    for name, array in replay.filled().items():
        assert np.array_equal(array, own[name].numpy()[: len(array)]), name


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"perception.bins": 21}, "bins=15, .*; perception asks for bins=21, "),
        ({"rewards.pitch.lambda_2": 3.0}, "was recorded with other rewards .*td_weight=0"),
        ({"agent.replay_size": 100}, "agent.replay_size: 100 transitions leave no room"),
        ({"agent.privileged_value": True}, "privileged_value: .* hold no privileged states"),
    ],
)
def test_episodes_that_do_not_fit_the_training_are_refused(
    file: Path, changes: dict[str, Any], text: str
) -> None:
    with pytest.raises(ConfigError, match=text):
        read_teacher(short_config(**{"teacher.episodes": str(file), **changes}))


def test_labels_alone_may_come_from_other_rewards_and_must_be_there(file: Path) -> None:
    alone = {"teacher.td_weight": 0.0, "teacher.episodes": str(file)}
    other = {"rewards.pitch.lambda_2": 3.0, "agent.privileged_value": True}
    config = short_config(**alone, **other)
    assert not config.agent.privileged(config)  # nothing would use it
    found = read_teacher(config)
    assert found is not None
    for episode in found.episodes:
        episode.labels[:] = 0.0
    with pytest.raises(ConfigError, match="holds no labels, so that nothing is learnt with teach"):
        check_fit(config, found)
    check_fit(short_config(**alone, **{"teacher.controller": {"name": "okada"}}), found)


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """One step, driven with another robot, physics and sensing."""
    robot = {"angle_step": 0.1, "flipper_length": 0.3, "track_speed": 0.4}
    config = EnvConfig(
        terrain="step",
        robot=robot,
        sim={"name": "planar", "friction": 0.75},
        perception={"name": "planar", "noise": 0.01, "occlusion": True},
        episode={"slack": 4},
        randomise={"robot": {"chassis_mass": [30, 40]}, "sim": {"gravity": 9.8}},
    )
    (found,) = play_episodes(config, OKADA, episodes=1, seed=5, record=True)
    path = tmp_path / "elsewhere.safetensors"
    recording.write(path, "okada", [(config, [found[RECORDED]])])
    return path


def test_episodes_of_another_robot_are_refused_with_every_difference(elsewhere: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        read_teacher(short_config(**{"teacher.episodes": str(elsewhere)}))
    assert str(caught.value) == (
        f"teacher.episodes: {elsewhere} was recorded with another robot: robot.flipper_length=0.3 "
        f"(here 0.536), robot.angle_step=0.1 (here {math.pi / 12}), robot.track_speed=0.4 (here "
        "0.2), a decision period of 0.229183 s (here 0.6); record it again with the robot of the "
        "training, or train with robot.flipper_length=0.3 robot.angle_step=0.1 "
        "robot.track_speed=0.4"
    )
    agreeing = {"robot.angle_step": 0.1, "robot.flipper_length": 0.3}
    settings = {"teacher.episodes": str(elsewhere), **agreeing}
    assert read_teacher(short_config(**settings, **{"robot.track_speed": 0.4})) is not None
    with pytest.raises(
        ConfigError, match=r"another robot: robot\.track_speed=0\.4 \(here 0\.2\); "
    ):
        read_teacher(short_config(**settings))


def test_other_conditions_of_recorded_episodes_are_stated(elsewhere: Path, file: Path) -> None:
    found = recording.read(elsewhere)
    assert differing_conditions(short_config(), found) == (
        f"teacher.episodes: {elsewhere} was recorded under other conditions: sim.friction=0.75 "
        "(here 1.0), perception.noise=0.01 (here 0.0), perception.occlusion=true (here false), "
        "episode.slack=4.0 (here 3.0), randomise.sim.gravity=9.8 (here null), "
        "randomise.robot.chassis_mass=[30.0,40.0] (here null)"
    )
    in_3d = short_config(sim={"name": "mujoco", "friction": 0.75})
    assert "sim=planar (here mujoco), perception" in differing_conditions(in_3d, found)
    assert differing_conditions(short_config(), recording.read(file)) == ""


def test_that_sums_over_recorded_decisions_are_not_cut_is_stated(
    file: Path, tmp_path: Path
) -> None:
    settings = {"teacher.episodes": str(file), "agent.cut_at_random": True, "train.decisions": 40}
    run = trainer(few(**settings, **{"agent.learning_starts": 90}), tmp_path)
    run.listeners.append(listener := Notes())
    run.run()
    assert listener.notes == [
        f"teacher.episodes: {file} does not say which actions were random: sums of rewards over "
        "its decisions are not cut, whatever agent.cut_at_random"
    ]
    assert run.progress.updates == 40 // 2  # the recorded decisions count before learning


# When the student drives: as soon as it learns.


@pytest.mark.parametrize("starts", [30, 1000])
def test_recorded_decisions_count_before_the_student_drives(
    starts: int, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings: dict[str, Any] = {
        "agent.learning_starts": starts,
        "teacher.controller": {"name": "okada"},
        "teacher.episodes": str(file),
    }
    begins = max(1, starts - recording.read(file).decisions)
    made: list[dict[str, Any]] = []

    class Workers(RolloutWorkers):
        def __init__(
            self, count: int, config: TrainConfig, shared: Mapping[str, Any], *more: Any
        ) -> None:
            made.append(dict(shared))
            super().__init__(count, config, shared, *more)

    monkeypatch.setattr(episodes, "RolloutWorkers", Workers)
    fast = trainer(few(**settings, **{"train.mode": "fast"}), tmp_path / "fast")
    fast.run(lambda: True)
    recorded = recording.read(file).decisions
    assert [max(1, starts - shared["recorded"]) for shared in made] == [begins]
    assert begins == max(1, starts - recorded)

    learns: list[Callable[[], bool]] = []

    def taught(*arguments: Any) -> DaggerPolicy:
        learns.append(arguments[3])
        return DaggerPolicy(*arguments)

    monkeypatch.setattr(controllers, "DaggerPolicy", taught)
    exact = trainer(few(**settings), tmp_path / "exact")
    exact.run(lambda: True)
    for decision, student in ((begins - 1, False), (begins, True)):
        exact.progress.decision = decision
        assert [check() for check in learns] == [student]


# The files in which a training keeps its episodes while it runs.


def test_each_checkpoint_writes_its_new_episodes_alone_and_a_kill_loses_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folders are copied where a kill would leave them: before and after a checkpoint."""
    config = few(**{"train.record": True, "train.checkpoint_every": 40})
    whole, save, count = tmp_path / "whole", Trainer._write_last, itertools.count()

    def copying(self: Trainer, *given: Any) -> None:
        number = next(count)
        if number == 5:
            shutil.copytree(whole, tmp_path / "before")
        save(self, *given)
        if number == 5:
            shutil.copytree(whole, tmp_path / "after")

    monkeypatch.setattr(Trainer, "_write_last", copying)
    trainer(config, whole).run()
    monkeypatch.undo()
    for folder in (tmp_path / "before", tmp_path / "after"):
        parts = [recording.read(path).episodes for path in sorted((folder / PARTS).iterdir())]
        assert len(parts) >= 3
        saved = checkpoint.read(folder / checkpoint.LAST)
        assert saved.document.state is not None
        written = [episode.number for part in parts for episode in part]
        assert written == list(range(len(written)))
        late = len(written) - saved.document.state.episode
        assert late == (len(parts[-1]) if folder.name == "before" else 0)
        (folder / PARTS / f".{99:08}.safetensors.1-ab.part").touch()
        clear_leftovers(folder)
        resumed = trainer(saved.config(), folder)
        resumed.restore(saved)
        resumed.run()
        for name in (checkpoint.LAST, EPISODES):
            assert (folder / name).read_bytes() == (whole / name).read_bytes()
        assert not (folder / PARTS).exists()
    (whole / EPISODES).write_bytes(b"x" * 100)
    with pytest.raises(CheckpointError, match="damaged"):
        trainer(config, whole).restore(checkpoint.read(whole / checkpoint.LAST))
