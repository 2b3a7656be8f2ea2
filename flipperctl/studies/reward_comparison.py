"""Play the same episodes with several policies and rank the policies by several rewards.

In: an evaluation's configuration, sets of reward terms, and policies. Out: a ``SceneRanking``. The
episodes are played once for all rewards, since the environment computes the terms of all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flipperctl.api import RewardTerm
from flipperctl.config import EvalConfig
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.judging import Progress, no_progress, play_scene
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource
from flipperctl.studies.ranking import SceneRanking, common_episodes, decide, measures, rank

Rewards = Mapping[str, RewardTerm]
"""Reward terms by name."""


@dataclass(frozen=True)
class RewardScene:
    """A scene, and the rewards by which policies are ranked on it."""

    config: EvalConfig
    """``config.eval`` holds the number of episodes and the seed."""
    rewards: Mapping[str, Rewards]
    """Reward terms by the label of their set."""


def rank_policies(
    scenes: Sequence[RewardScene],
    policies: Mapping[str, PolicySource],
    progress: Progress = no_progress,
) -> list[SceneRanking]:
    """Rank the policies on every scene, and find the contradictions among all of them.

    Raises:
        FlipperctlError: a policy does not fit a scene, found before the first episode, or as for
            ``compare_rewards``.
    """
    for scene in scenes:
        for label, source in policies.items():
            source.build(scene.config)  # raises for a wrong layout or robot
            if len(scene.rewards) > 1 and source.plans_for_rewards:
                raise ConfigError(
                    f"--compare: {label} drives otherwise for each of the rewards "
                    f"{', '.join(scene.rewards)}; one of them is allowed"
                )
    with EpisodeWorkers() as workers:
        ranked = [compare_rewards(scene, policies, workers, progress) for scene in scenes]
    return decide(ranked)


def compare_rewards(
    scene: RewardScene,
    policies: Mapping[str, PolicySource],
    workers: EpisodeWorkers,
    progress: Progress = no_progress,
) -> SceneRanking:
    """Play the scene's episodes with each policy; rank the policies by each of its rewards.

    ``policies``: their sources by the labels that the result uses; ``workers`` play the episodes.

    Raises:
        FlipperctlError: a policy cannot be built or failed, or an episode killed its workers.
    """
    config, terrain = scene.config, scene.config.terrain.plugin_name
    every = {f"{at}.{n}": t for at, terms in scene.rewards.items() for n, t in terms.items()}
    with_every_term = config.model_copy(update={"rewards": every})
    played = {
        label: play_scene(with_every_term, source, f"{terrain}, {label}", workers, progress)
        for label, source in policies.items()
    }
    return SceneRanking(
        terrain,
        config.eval.seed,
        Conditions.of(config),
        episodes=config.eval.episodes,
        common=len(next(iter(common_episodes(played).values()))),
        policies=measures(played),
        rankings=tuple(
            rank(label, terms, played, prefix=f"{label}.") for label, terms in scene.rewards.items()
        ),
    )
