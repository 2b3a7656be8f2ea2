"""Play the same episodes with a policy and with references, and measure the policy's regret.

In: an evaluation's configuration, and the sources of the policies. Out: a ``SceneRegret``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flipperctl.config import EvalConfig
from flipperctl.errors import ConfigError
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.judging import Progress, no_progress, play_scene
from flipperctl.evaluation.returns import paying_terms
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource
from flipperctl.studies.regret import LEVEL, Played, SceneRegret, regret


@dataclass(frozen=True)
class RegretScene:
    """A scene on which a policy is compared with references by its reward."""

    config: EvalConfig
    """``config.eval`` holds the number of episodes and the seed; its rewards make the return."""
    rewards: str
    """Label of the reward terms."""
    name: str
    """Name of the policy in the result."""
    policy: PolicySource
    references: Mapping[str, PolicySource]
    """By name; ``LEVEL`` is added if it is missing, and the policy itself is left out."""


def measure_regrets(
    scenes: Sequence[RegretScene], progress: Progress = no_progress
) -> list[SceneRegret]:
    """Return the regret on each scene.

    Raises:
        FlipperctlError: a reference does not fit a scene, found before the first episode, or as
            for ``measure_regret``.
    """
    for scene in scenes:
        for source in scene.references.values():
            source.build(scene.config)  # raises for a wrong layout or robot
    with EpisodeWorkers() as workers:
        found = [measure_regret(scene, workers, progress) for scene in scenes]
    return [one for one in found if one is not None]


def measure_regret(
    scene: RegretScene, workers: EpisodeWorkers, progress: Progress = no_progress
) -> SceneRegret | None:
    """Play the scene's episodes with every policy, equal ones once; return the regret.

    Returns None if ``workers`` were stopped, since the episodes are then not the same.

    Raises:
        FlipperctlError: a policy cannot be built or failed, an episode killed its workers, or no
            reward term is left to judge by.
    """
    if not paying_terms(scene.config.rewards):
        raise ConfigError(f"rewards: {scene.rewards!r} leaves no term to judge a policy by")
    terrain = scene.config.terrain.plugin_name
    known: list[tuple[PolicySource, list[EpisodeResult]]] = []

    def play(name: str, source: PolicySource) -> list[EpisodeResult]:
        for earlier, episodes in known:
            if earlier == source:
                return episodes
        played = play_scene(scene.config, source, f"{terrain}, {name}", workers, progress)
        known.append((source, played))
        return played

    sources = {LEVEL: PolicySource.of_plugin(LEVEL, "controller"), **scene.references}
    own = play(scene.name, scene.policy)
    others = {
        name: play(name, source)
        for name, source in sources.items()
        if name == LEVEL or source != scene.policy
    }
    if workers.interrupted:
        return None
    return regret(scene.config, scene.rewards, Played(scene.name, own, others))
