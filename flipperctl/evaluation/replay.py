"""Play a recorded episode again, and compare it with its record bit for bit.

In: the file of a record. Out: the episode, and whether it is the recorded one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from flipperctl.api import Profile, Transition
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.episode_record import EpisodeRecord, measures, read_record, risks
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, Row, arranged
from flipperctl.evaluation.runner import EpisodeDigest
from flipperctl.policies.source import PolicySource
from flipperctl.rollout.episode import Decision, play


@dataclass(frozen=True)
class Replay:
    """An episode that was played again."""

    record: EpisodeRecord
    config: EvalConfig
    source: PolicySource
    episode: Row
    transitions: tuple[Transition, ...]
    profile: Profile

    @property
    def differences(self) -> list[str]:
        """What differs from the record; empty if the episode is bit-identical."""
        recorded, episode = self.record, self.episode
        found = []
        if episode["outcome"] != recorded.outcome:
            found.append(f"outcome {episode['outcome']} ({recorded.outcome})")
        ours = measures(episode)
        found += [
            f"{name} {ours.get(name)} ({value})"
            for name, value in recorded.measures.items()
            if ours.get(name) != value
        ]
        if recorded.digest is not None and episode[DIGEST] != recorded.digest:
            found.append(f"digest {episode[DIGEST]} ({recorded.digest})")
        if recorded.risks is not None:
            pairs = zip_longest(risks(episode) or (), recorded.risks)
            found += [f"risk {t}: {us} ({it})" for t, (us, it) in enumerate(pairs) if us != it][:1]
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "controller": self.record.policy.label,
            "terrain": self.config.terrain.plugin_name,
            "conditions": dict(self.record.conditions),
            "episode": self.record.episode,
            "seed": self.record.seed,
            "outcome": self.episode["outcome"],
            "measures": measures(self.episode),
            "digest": self.episode[DIGEST],
            "identical": not self.differences,
            "differences": self.differences,
        }


def replay(path: Path, checkpoint: Path | None = None, progress: Progress = no_progress) -> Replay:
    """Play the episode of a record; ``checkpoint`` replaces the path of its policy.

    Raises:
        RequestError: the file is no record, its versions, conditions or plugins differ from those
            here, or its policy is missing or has another content.
        FlipperctlError: the policy failed.
    """
    record = read_record(path)
    record.check_package(path)
    source = record.policy.find(path, checkpoint)
    config = record.evaluation(path)
    record.check_versions(path, source, config)
    environment = config.environment()
    env, policy = FlipperEnv(config=environment), source.build(environment)
    digest, transitions = EpisodeDigest(), list[Transition]()

    def watch(decision: Decision) -> None:
        digest.add(decision)
        transitions.append(decision.transition)

    with progress(f"{config.terrain.plugin_name}, replay", 1) as report:
        row = play(env, policy, record.seed, watch=watch, report_progress=report)
    episode = arranged({"episode": record.episode, **row}) | {DIGEST: digest.hexdigest()}
    return Replay(record, config, source, episode, tuple(transitions), env.profile)
