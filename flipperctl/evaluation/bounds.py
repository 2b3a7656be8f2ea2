"""The static lower bound of θ̂_R on the ground of each episode (``eval.static_bound``)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.sim.statics import static_bound

LONGEST = 100.0
"""Longest ground whose bound is computed [m]; it takes 50 ms per metre."""


def episode_bound(env: FlipperEnv) -> float | None:
    """Return the bound of the episode that ``env.reset`` began [rad]; None on very long ground."""
    start, finish = float(env.state.position[0]), env.drive.termination.finish
    if finish - start > LONGEST:
        return None
    episode = env.config.episode
    on_level_ground = finish >= env.profile.end
    return static_bound(
        env.profile.points,
        env.robot,
        start=start,
        finish=finish,
        pitch=env.state.pitch,
        clearance=episode.clearance if on_level_ground else math.inf,
        overturn=episode.overturn,
    )


def static_bounds(
    config: EnvConfig,
    seeds: Iterable[int],
    report: Callable[[float], None],
    stop: Callable[[], bool],
) -> dict[int, float]:
    """Return the bound by seed [rad], of the first seeds alone once ``stop`` returns True.

    ``report`` is called with the number of finished ones.
    """
    env, found = FlipperEnv(config=config), dict[int, float]()
    for done, seed in enumerate(seeds, 1):
        if stop():
            break
        env.reset(seed=seed)
        bound = episode_bound(env)
        if bound is not None:
            found[seed] = bound
        report(done)
    return found


def with_bounds(episodes: Sequence[EpisodeResult], bounds: dict[int, float]) -> list[EpisodeResult]:
    """Return the episodes with the bounds of their seeds."""
    return [replace(e, static_bound=bounds.get(e.seed)) for e in episodes]
