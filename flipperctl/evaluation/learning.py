"""Episodes by which controllers are tuned: of trainings, and of recorded drives to learn from.

In: scenes, an objective, candidates, or a number of episodes and a demonstrator. Out: the scores of
the candidates, or one ``RecordedEpisode`` after the other, played in this process.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flipperctl.api import ObservationLayout, Policy, RecordedEpisode, Robot
from flipperctl.checkpoint import recording
from flipperctl.config.policy_file import drive_files
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import InterruptedRunError, PluginFailedError, RequestError
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.seeds import PRICE, Scores, SeedSamples
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.rollout.episode import Decision, EpisodeRecorder, play, training_seed

Objective = Literal["pitch", "reward"]


class Demonstrator:
    """Who shows a controller what to do: recorded drives, or a policy."""

    def __init__(self, word: str, entries: Sequence[Entry]) -> None:
        """``word``: of ``from=``, a folder or file of drives, or a policy's name or file.

        Raises:
            CheckpointError, ConfigError: it is neither, or does not fit the scenes.
            RequestError: the drives have another observation layout or robot than the scenes.
        """
        self.drives: tuple[RecordedEpisode, ...] = ()
        self.source: PolicySource | None = None
        # A policy must fit every scene.
        if not drive_files(Path(word)):
            self.source = load_policy(word, "from")
            for entry in entries:
                self.source.build(entry.config)
            return
        # Drives must have the observations and the robot of the scenes.
        drives = recording.read(Path(word))
        self.drives, config = drives.episodes, entries[0].config
        robot = {name: value for name, value in config.robot if isinstance(value, float)}
        for drive in drives.document.environments:
            recorded = drive.perception.layout.words
            if recorded != (current := config.perception.layout.words):
                raise RequestError(f"from={word}: its observations have {recorded}; here {current}")
            for name, value in robot.items():
                if drive.robot.get(name) != value:
                    raise RequestError(
                        f"from={word}: it was driven with robot.{name}={drive.robot.get(name)}; "
                        f"here {value:g}"
                    )


class PlayedEpisodes:
    """The ``TrainingEpisodes`` of a search."""

    def __init__(
        self,
        entries: Sequence[Entry],
        objective: Objective,
        seed: int,
        count: int,
        demonstrator: Demonstrator | None = None,
        stop: Callable[[], bool] = lambda: False,
        report: Callable[[float], None] = lambda done: None,
    ) -> None:
        """``count``: episodes that may be played; ``seed``: a training's.

        ``stop`` is called before each episode, and once it returns True, no other one begins.
        ``report`` is called with the number of played episodes.

        Raises:
            RequestError: the scenes have different layouts or robots.
        """
        self.rng = np.random.default_rng(seed)
        first = entries[0].config
        self.layout: ObservationLayout = first.perception.layout
        self.robot: Robot = first.robot
        for entry in entries:
            if (entry.config.perception.layout, entry.config.robot) != (self.layout, self.robot):
                raise RequestError("a controller learns on scenes of one layout and one robot")
        self._entries, self._objective, self._seed = entries, objective, seed
        self._count, self._played, self._demonstrator = count, 0, demonstrator
        self._stop, self._report = stop, report

    @cached_property
    def _envs(self) -> list[FlipperEnv]:
        return [FlipperEnv(config=entry.config) for entry in self._entries]

    @property
    def left(self) -> int:
        """Number of episodes that may still be played."""
        return self._count - self._played

    def play(self, policy: Policy) -> RecordedEpisode:
        """Play the next episode; see ``TrainingEpisodes``."""
        if not self.left:
            raise PluginFailedError(
                f"learn played more than its {self._count} episodes; it may play while "
                "episodes.left is above 0"
            )
        if self._stop():
            raise InterruptedRunError("interrupted")
        recorder, by_reward = EpisodeRecorder(self.robot), self._objective == "reward"

        def add(d: Decision) -> None:
            reward = d.reward
            # A smooth episode is one of little pitch variation; failing has a price.
            if not by_reward:
                failed = d.ending is not None and d.ending["outcome"] != "reached"
                swing = float(np.abs(np.diff(d.transition.path[:, 2])).sum())
                reward = -swing - (PRICE if failed else 0.0)
            before, after = d.perception.observation, d.next_perception.observation
            recorder.add(before, d.action, reward, after, None)

        env = self._envs[self._played % len(self._envs)]
        ending = play(env, policy, training_seed(self._seed, self._played), watch=add)
        self._played += 1
        self._report(self._played)
        return recorder.finish(self._played - 1, ending)

    def demonstrations(self) -> Iterator[RecordedEpisode]:
        """Yield the episodes of the demonstrator; see ``TrainingEpisodes``."""
        shown = self._demonstrator
        if shown is None:
            raise PluginFailedError("learn asks for demonstrations without imitates = True")
        if shown.source is None:
            yield from shown.drives
            return
        policies = [shown.source.build(entry.config) for entry in self._entries]
        while self.left:
            yield self.play(policies[self._played % len(policies)])


@dataclass
class Playing:
    """Measures candidates by episodes of trainings, which no evaluation plays."""

    entries: Sequence[Entry]
    """The controller on each scene."""
    objective: Objective
    seed: int
    player: Player
    """One of ``training``."""
    tell_size: Callable[[int], None]
    """Called with the number of episodes of each candidate and scene before they are played."""

    def __call__(
        self, candidates: Sequence[Mapping[str, Any]], draws: int, episodes: int, label: str
    ) -> list[Scores]:
        """Return the scores of the candidates; see ``Measure``."""
        seed = training_seed(self.seed, draws)
        self.tell_size(episodes)
        # All candidates on all scenes at once, so that the processes share them
        requests = [
            (_numbered(entry, episodes, seed), replace(entry.source, settings=settings))
            for fields in candidates
            for entry in self.entries
            for settings in [{**(entry.source.settings or {}), **fields}]
        ]
        played = list(self.player.play_many(requests, label))
        if len(played) < len(requests):
            raise InterruptedRunError("interrupted")
        # A failure costs a whole turn; a return counts as it is.
        price = math.inf if self.objective == "reward" else PRICE
        count = len(self.entries)
        parts = [played[at : at + count] for at in range(0, len(played), count)]
        return [SeedSamples("", *self._samples(scenes)).scores(price) for scenes in parts]

    def _samples(self, scenes: Sequence[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return values and whether the finish was reached, by scene; all count for a reward."""
        values, reached = {}, {}
        for at, rows in enumerate(scenes):
            by_reward = self.objective == "reward"
            numbers = rows.values("return" if by_reward else "pitch_variation_100hz")
            values[str(at)] = np.array([numbers]) * (-1 if by_reward else 1)
            reached[str(at)] = np.array(
                [[by_reward or row["outcome"] == "reached" for row in rows]]
            )
        return values, reached


def _numbered(entry: Entry, episodes: int, seed: int) -> Any:
    numbers = entry.config.eval.model_copy(update={"episodes": episodes, "seed": seed})
    return entry.config.model_copy(update={"eval": numbers})
