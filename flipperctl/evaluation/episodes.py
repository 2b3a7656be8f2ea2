"""Play the episodes of an evaluation in order, in one process or several.

In: an environment configuration and a policy's source. Out: one result per episode,
independent of the number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from flipperctl.config import EnvConfig
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.runner import EpisodeRunner
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource


def play_episodes(
    config: EnvConfig,
    source: PolicySource,
    *,
    episodes: int | Sequence[int],
    seed: int,
    workers: EpisodeWorkers | None = None,
    report_progress: Callable[[float], None] = lambda fraction: None,
    record: bool = False,
) -> Iterator[EpisodeResult]:
    """Yield the results of the episodes in order, each as soon as it is available.

    ``episodes`` is their number, counted from 0, or their indices. ``workers`` play them if there
    are several workers and several episodes; otherwise this process does, and calls
    ``report_progress`` with the finished fraction of an episode's search. ``record``: whether the
    results include decisions. Fewer episodes are played if ``workers.stop`` returns True.

    Raises:
        FlipperctlError: the policy cannot be built or failed, or an episode killed its workers.
    """
    indices = range(episodes) if isinstance(episodes, int) else episodes
    if workers is not None and workers.count > 1 and len(indices) > 1:
        yield from workers.play(config, source, indices, seed, record=record)
    elif indices:
        runner = EpisodeRunner(config, source, seed, report_progress, record=record)
        for index in indices:
            if workers is not None and workers.stop():
                return
            yield runner.play(index)
