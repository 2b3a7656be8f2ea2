"""Episodes of an evaluation, played without its plan and its store."""

from collections.abc import Sequence

from flipperctl.config import EnvConfig
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.evaluation.rows import Row
from flipperctl.policies.source import PolicySource


def play_episodes(
    config: EnvConfig,
    source: PolicySource,
    *,
    episodes: int | Sequence[int],
    seed: int,
    record: bool = False,
) -> list[Row]:
    """Play episodes in this process; ``episodes`` is their number or their indices."""
    runner = EpisodeRunner(config, source, seed, record=record)
    indices = range(episodes) if isinstance(episodes, int) else episodes
    return [runner.play(index) for index in indices]
