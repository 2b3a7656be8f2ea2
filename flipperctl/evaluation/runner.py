"""Play any episode of an evaluation.

In: an environment configuration, a policy's source and the seed of the evaluation. Out: the result
of an episode, or its states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from flipperctl.api import Profile, RobotState, Transition
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.evaluation.digest import EpisodeDigest
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.policies.demonstrating import DemonstratingPolicy
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, decisions, play
from flipperctl.rollout.recording import EpisodeRecorder
from flipperctl.rollout.seeds import EvaluationSeeds


class EpisodeRunner:
    """An environment and a policy, ready to play any episode of an evaluation."""

    def __init__(
        self,
        config: EnvConfig,
        source: PolicySource,
        seed: int,
        report_progress: Callable[[float], None] = lambda fraction: None,
        *,
        record: bool = False,
    ) -> None:
        """Build the environment and the policy.

        ``seed`` is the seed of the evaluation. ``report_progress`` is called with the finished
        fraction of an episode's search. ``record``: whether results include decisions.

        Raises:
            FlipperctlError: the policy cannot be built (see ``PolicySource.build``).
        """
        self._env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._policy = source.build(config)
        self._seeds = EvaluationSeeds.of(seed, config.terrain)
        self._record = record
        require_repeatable(self._env, self._seeds(0))

    def play(self, index: int) -> EpisodeResult:
        """Play one episode, counted from 0, to its end."""
        seed = self._seeds(index)
        if self._record:
            return self._recorded(index, seed)
        digest, report = EpisodeDigest(), self._report_progress
        row = play(self._env, self._policy, seed, watch=digest.add, report_progress=report)
        return EpisodeResult.of(index, row, digest.hexdigest())

    def _recorded(self, index: int, seed: int) -> EpisodeResult:
        policy, recorder = DemonstratingPolicy(self._policy), EpisodeRecorder()
        digest = EpisodeDigest()

        def watch(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            recorder.add(before, d.action, d.reward, after, policy.label)
            digest.add(d)

        row = play(self._env, policy, seed, watch=watch, report_progress=self._report_progress)
        episode = EpisodeResult.of(index, row, digest.hexdigest())
        return replace(episode, recorded=recorder.finish(index, row))

    def trace(self, index: int) -> tuple[list[RobotState], Profile]:
        """Play one episode; return the states at all T + 1 decisions, and the ground."""
        transitions, profile = self.transitions(index)
        return [transitions[0].before, *(t.after for t in transitions)], profile

    def transitions(self, index: int) -> tuple[list[Transition], Profile]:
        """Play one episode; return its T transitions, and the ground."""
        seed = self._seeds(index)
        made = decisions(self._env, self._policy, seed, report_progress=self._report_progress)
        return [d.transition for d in made], self._env.profile
