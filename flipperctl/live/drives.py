"""Drives of people and scripts: what is driven at a page, and files that repeat it bit for bit.

In: a scene, a policy that commands flippers and belts, a folder. Out: for each drive an episode
file, by which ``operator`` repeats it and from which a policy learns, and its record for
``flipperctl replay``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from flipperctl.api import Policy, RecordedEpisode
from flipperctl.checkpoint import recording
from flipperctl.config import EvalConfig
from flipperctl.config.policy_file import drive_files
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.evaluation.play import EpisodeDigest
from flipperctl.evaluation.replay import EpisodeRecord
from flipperctl.evaluation.rows import DIGEST, Row, arranged
from flipperctl.live.drive import AgainError, DrivePage, Person
from flipperctl.policies.controllers import from_action
from flipperctl.policies.operator import Operator
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, EpisodeRecorder, EvaluationSeeds, play
from flipperctl.text.files import write_json

PRACTICE = 1_000_000
"""Index of the first draw for practice, which no evaluation has."""


class DriveFolder:
    """The drives of one operator."""

    def __init__(self, path: Path, driver: str) -> None:
        """``driver``: who drives, such as ``person: anna`` or ``script: slow``."""
        self.path, self.driver = path, driver
        if path.exists() and not path.is_dir():
            raise RequestError(f"--output {path}: it is a file; a folder for drives is allowed")
        for file in drive_files(path):
            other = recording.read(file).document.driver
            if other != driver:
                raise RequestError(
                    f"--output {path}: it holds drives of {other!r}, not of {driver!r}; a folder "
                    "holds the drives of one operator"
                )

    def check(self, config: EvalConfig) -> None:
        """Check that the drives that the folder holds have the settings of further ones."""
        Operator(drives=str(self.path)).check(config)

    def file(self, config: EvalConfig, seed: int) -> Path:
        """Return the file of a drive on the draw with this seed."""
        return self.path / f"drive_{config.terrain.plugin_name}_{seed}.safetensors"

    def missing(self, config: EvalConfig, first: int, count: int) -> list[int]:
        """Return the episodes that were not driven yet, among ``count`` from ``first`` on."""
        seeds = EvaluationSeeds.of(config.eval.seed, config.terrain)
        wanted = range(first, first + count)
        return [i for i in wanted if not self.file(config, seeds(i)).exists()]

    def next(self, config: EvalConfig, first: int | None, count: int) -> list[int]:
        """Return the episodes to drive from ``first`` on; None: the first that were not driven."""
        if first is None:
            driven = len(drive_files(self.path))
            return self.missing(config, 0, driven + count)[:count]
        wanted = list(range(first, first + count))
        if again := set(wanted) - set(self.missing(config, first, count)):
            raise RequestError(
                f"--episode {min(again)}: {self.path} holds a drive of it; delete its files to "
                "drive it again, or leave --episode out for the next one"
            )
        return wanted

    def drive(
        self,
        config: EvalConfig,
        env: FlipperEnv,
        policy: Policy,
        index: int,
        *,
        watch: Callable[[Decision], None] = lambda decision: None,
        keep: bool = True,
    ) -> Row:
        """Let an operator drive an episode; return its row.

        ``policy`` has ``command_period`` and ``command``; see ``flipperctl.api.Policy``. The files
        are written once the episode has ended, or not at all; ``keep``: whether they are.
        """
        seed = EvaluationSeeds.of(config.eval.seed, config.terrain)(index)
        recorder, digest = EpisodeRecorder(config.robot), EpisodeDigest()

        def seen(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            label = from_action(d.action, len(config.robot.joints))
            recorder.add(before, d.action, d.reward, after, label, d.transition.commands)
            digest.add(d)
            watch(d)

        ending = play(env, policy, seed, watch=seen)
        row = arranged({"episode": index, **ending}) | {DIGEST: digest.hexdigest()}
        if keep:
            self._write(config, recorder.finish(index, ending), row, policy)
        return row

    def _write(
        self, config: EvalConfig, episode: RecordedEpisode, row: Row, policy: Policy
    ) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        file = self.file(config, episode.seed)
        period = getattr(policy, "command_period", None)
        recording.write(file, self.driver, [(config, [episode])], period)
        settings = {"name": "operator", "drives": str(file)}
        source = PolicySource(settings=settings, name=str(file))
        record = EpisodeRecord.of(config, source, row)
        write_json(file.with_suffix(".json"), record.model_dump(mode="json"))


@dataclass(frozen=True)
class Task:
    """One episode that somebody is to drive."""

    title: str
    config: EvalConfig
    index: int
    folder: DriveFolder
    helper: PolicySource | None = None
    """Policy that commands the flippers which the operator does not take; None: no one helps."""
    practice: bool = False
    """Whether it is for practice, and is not recorded."""
    repeatable: bool = True
    """Whether the operator may drive it again once it has ended."""
    asks: str = ""
    """Name of the block after which the questions are asked; empty: none are asked."""

    @property
    def number(self) -> int:
        """Index that people read, from 0."""
        return self.index - PRACTICE if self.practice else self.index


Answered = Callable[[Task, tuple[int, ...]], None]


def drive(
    page: DrivePage,
    tasks: Sequence[Task],
    driven: Callable[[Task, Row, float], None],
    answered: Answered = lambda task, answers: None,
) -> None:
    """Let the operator at the page drive each task.

    ``driven`` is called with each row and the share of ticks that were late, ``answered`` with
    answers of NASA-TLX.
    """
    for number, task in enumerate(tasks):
        config = task.config
        title = f"{task.title}{', practice' if task.practice else ''}"
        about = {"title": title, "episode": task.number, "practice": task.practice}
        word = "again"
        # An episode that is begun anew gets a world of its own.
        while word == "again":
            env = FlipperEnv(config=config)
            helper = None if task.helper is None else task.helper.build(config)
            person = Person(page, env, helper, about)
            try:
                keep = not task.practice
                row = task.folder.drive(config, env, person, task.index, keep=keep)
                driven(task, row, person.late / max(1, person.count))
                left = len(tasks) - number - 1
                word = page.end(row["outcome"], left)
            except AgainError:
                continue
            finally:
                person.remove()
            if not (task.repeatable or task.practice):
                word = "next"
        if task.asks:
            answered(task, page.ask())
    page.finish()
