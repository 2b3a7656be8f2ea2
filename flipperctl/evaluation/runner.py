"""Play any episode of an evaluation.

In: an environment configuration, a policy's source and the seed of the evaluation. Out: the row of
an episode, or its transitions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np

from flipperctl.api import Profile, Transition
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.repeating import require_repeatable
from flipperctl.evaluation.rows import DIGEST, RECORDED, Row, arranged
from flipperctl.policies.demonstrating import DemonstratingPolicy
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, decisions, play
from flipperctl.rollout.recording import EpisodeRecorder
from flipperctl.rollout.seeds import EvaluationSeeds


class EpisodeDigest:
    """SHA-256 of each decision's action and of the poses at 100 Hz: equal for equal episodes."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, decision: Decision) -> None:
        """Add the action and the poses (S + 1, 5) of a decision, as little-endian numbers."""
        self._hash.update(int(decision.action).to_bytes(1, "little"))
        self._hash.update(np.ascontiguousarray(decision.poses, dtype="<f8").tobytes())

    def hexdigest(self) -> str:
        """Return the digest of the decisions so far."""
        return self._hash.hexdigest()


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
        fraction of an episode's search. ``record``: whether rows include the decisions.

        Raises:
            FlipperctlError: the policy cannot be built (see ``PolicySource.build``).
        """
        self.env = FlipperEnv(config=config)
        self._report_progress = report_progress
        self._policy = source.build(config)
        self._seeds = EvaluationSeeds.of(seed, config.terrain)
        self._record = record
        require_repeatable(self.env, self._seeds(0))

    def play(self, index: int) -> Row:
        """Play one episode, counted from 0, to its end; return its row."""
        digest, report, seed = EpisodeDigest(), self._report_progress, self._seeds(index)
        if not self._record:
            row = play(self.env, self._policy, seed, watch=digest.add, report_progress=report)
            return arranged({"episode": index, **row}) | {DIGEST: digest.hexdigest()}
        policy, recorder = DemonstratingPolicy(self._policy), EpisodeRecorder()

        def watch(d: Decision) -> None:
            before, after = d.perception.observation, d.next_perception.observation
            recorder.add(before, d.action, d.reward, after, policy.label)
            digest.add(d)

        row = play(self.env, policy, seed, watch=watch, report_progress=report)
        recorded = {DIGEST: digest.hexdigest(), RECORDED: recorder.finish(index, row)}
        return arranged({"episode": index, **row}) | recorded

    def transitions(self, index: int) -> tuple[list[Transition], Profile]:
        """Play one episode; return its T transitions, and the ground."""
        seed = self._seeds(index)
        made = decisions(self.env, self._policy, seed, report_progress=self._report_progress)
        return [d.transition for d in made], self.env.profile
