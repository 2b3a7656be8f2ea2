"""Fit the model of a map's errors to those of ``perception=lidar``, and compare the two.

    python -m benchmarks.map_errors [--terrain NAMES] [--episodes N] [--seed N] [OVERRIDE ...]

``okada`` drives with the LiDAR (OVERRIDE: its settings, ``perception.pose=matched`` by default), in
the engine of the side plane, so that nothing but perception differs. From the errors of the heights
in bins that were seen, ``perception.map_error``, ``map_length`` and ``map_drift`` are estimated; by
driving with the model once, ``map_drift`` is corrected and ``map_jitter`` takes the part of it
that changes from decision to decision. Then ``okada`` drives again on other episodes
with the LiDAR and with the model. The output shows the distributions and autocorrelations of both,
and θ̂_R of ``okada`` and ``generalist`` on the true ground, with the LiDAR and with the model.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Perception, Transition
from flipperctl.core.observation import occupied
from flipperctl.errors import RequestError
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.play import EpisodeRunner
from flipperctl.plugging import plugins
from flipperctl.process import entry
from flipperctl.sim.planar.sensing import NEAREST, MapErrorSize

LEVEL, STEEP = 0.01, 0.03
"""Neighbouring bins differ by less on level ground, and by more on sloped ground [m]."""
LAGS = (1, 2, 4, 6)
"""Bins, and decisions, between two errors that are correlated [-]."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
FITTED, COMPARED = 0, 1
"""Added to the seed of the episodes for the fit, and of those for the comparison."""


@dataclass(frozen=True)
class Errors:
    """Errors of the heights H in one episode of T decisions with N bins."""

    error: FloatArray
    """Perceived minus true, (T, N) [m]; NaN where nothing was seen."""
    true: FloatArray
    """True heights in frame L, (T, N) [m]."""
    width: float
    """Width of a bin [m]."""

    @classmethod
    def of(cls, episode: Sequence[Transition]) -> Errors:
        """Return the errors of an episode."""
        error = import_module("flipperctl_plugins.measures.mapping").height_errors(episode)
        perceived = [t.perception for t in episode if t.perception is not None]
        heights = np.array([p.observation[: error.shape[1]] for p in perceived], np.float64)
        seen = np.array([_seen(p) for p in perceived])
        width = perceived[0].layout.bin_width
        return cls(np.where(seen, error, np.nan), heights - error, width)

    @property
    def centres(self) -> FloatArray:
        """Middles of the bins ahead of the chassis centre, (N,) [m]."""
        count = self.error.shape[1]
        return np.asarray((np.arange(count) - (count - 1) / 2) * self.width)

    def slopes(self) -> FloatArray:
        """Slope of the true ground in each bin, (T, N) [-]."""
        return np.asarray(np.gradient(self.true, self.width, axis=1))

    def around(self) -> FloatArray:
        """Return the largest difference of the heights of bins next to each bin, (T, N) [m]."""
        rise = np.abs(np.diff(self.true, axis=1, prepend=np.nan, append=np.nan))  # (T, N + 1)
        wide = np.pad(np.nan_to_num(rise), ((0, 0), (1, 1)))
        return np.asarray(
            np.maximum.reduce([wide[:, i : i + self.true.shape[1]] for i in range(4)])
        )

    def level(self) -> FloatArray:
        """Return the errors on level ground, (T, N) [m]; NaN elsewhere."""
        return np.where(self.around() < LEVEL, self.error, np.nan)

    def sloped(self) -> FloatArray:
        """Return the errors on sloped ground and at steps, (T, N) [m]; NaN elsewhere."""
        return np.where(self.around() >= STEEP, self.error, np.nan)


def _seen(p: Perception) -> NDArray[np.bool_]:
    if p.seen is not None:
        return p.seen
    if p.filled is None:
        return np.ones(p.layout.bins, np.bool_)
    return occupied(p.points[~p.filled], p.layout.bins, p.layout.bin_width)


def fit(recorded: Sequence[Errors]) -> MapErrorSize:
    """Return the parameters of the model.

    ``height`` and ``length`` have the variance and the correlation of neighbouring bins of the
    errors on level ground, ``drift`` the mean square of the errors below and behind the robot that
    slopes explain.
    """
    width = recorded[0].width
    length = _length(correlation_along([e.level() for e in recorded], 1), width)
    variance = float(np.nanmean(_all(Errors.level, recorded) ** 2))
    height = math.sqrt(variance / _mean_variance(width / length))
    explained = square = 0.0
    for e in recorded:
        since = np.maximum(NEAREST - e.centres, 0.0)  # distance driven since a bin was passed [m]
        gain = e.slopes() ** 2 * since
        known = ~np.isnan(e.error) & (np.abs(e.slopes()) > STEEP / width) & (since > 0)
        explained += float(np.maximum(e.error[known] ** 2 - variance, 0.0).sum())
        square += float(gain[known].sum())
    return MapErrorSize(height, length, math.sqrt(explained / square) if square else 0.0)


def scale(recorded: Sequence[Errors], modelled: Sequence[Errors]) -> float:
    """Return the factor on ``drift`` at which the model is as wrong on sloped ground as recorded.

    It compares by how much the mean squares there exceed those on level ground, which is
    proportional to the square of ``drift``.
    """
    ours, model = _excess(recorded), _excess(modelled)
    return math.sqrt(ours / model) if model else 1.0


def _all(kind: Callable[[Errors], FloatArray], episodes: Sequence[Errors]) -> FloatArray:
    return np.concatenate([kind(e).ravel() for e in episodes])


def _excess(episodes: Sequence[Errors]) -> float:
    """Return by how much the mean square on sloped ground exceeds that on level ground [m²]."""
    level, sloped = (_all(kind, episodes) for kind in (Errors.level, Errors.sloped))
    return max(0.0, float(np.nanmean(sloped**2) - np.nanmean(level**2)))


def with_jitter(
    size: MapErrorSize, recorded: Sequence[Errors], modelled: Sequence[Errors]
) -> MapErrorSize:
    """Return the parameters with a displacement that is drawn anew at each decision.

    ``modelled``: errors of the model with ``size``, which has none. It takes the part of the errors
    on sloped ground that the recorded ones, whose correlation from one decision to the next is
    smaller, do not keep.
    """
    now, kept = (
        correlation_in_time([e.sloped() for e in kind], 1) for kind in (recorded, modelled)
    )
    share = min(1.0, max(0.0, now / kept))
    slopes = _all(Errors.slopes, recorded)[~np.isnan(_all(Errors.sloped, recorded))]
    jitter = math.sqrt((1 - share) * _excess(recorded) / float(np.mean(slopes**2)))
    drift = size.drift * scale(recorded, modelled) * math.sqrt(share)
    return replace(size, drift=drift, jitter=jitter)


def _mean_variance(ratio: float) -> float:
    """Return the variance of the process's mean over a bin; ``ratio``: its width by the length."""
    return 2 / ratio**2 * (ratio - 1 + math.exp(-ratio))


def _length(correlation: float, width: float) -> float:
    """Return the length at which the means of neighbouring bins have this correlation [m]."""
    low, high = 0.02, 5.0
    for _ in range(50):
        middle = math.sqrt(low * high)
        ratio = width / middle
        found = (1 - math.exp(-ratio)) ** 2 / ratio**2 / _mean_variance(ratio)
        low, high = (middle, high) if found < correlation else (low, middle)
    return low


def correlation_along(errors: Sequence[FloatArray], lag: int) -> float:
    """Return the correlation of errors ``lag`` bins apart at one decision, about zero."""
    return _correlation([(e[:, :-lag].ravel(), e[:, lag:].ravel()) for e in errors])


def correlation_in_time(errors: Sequence[FloatArray], lag: int) -> float:
    """Return the correlation of a bin's errors ``lag`` decisions apart, about zero."""
    return _correlation([(e[:-lag].ravel(), e[lag:].ravel()) for e in errors if len(e) > lag])


def _correlation(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    first, second = (np.concatenate(side) for side in zip(*pairs, strict=True))
    both = ~np.isnan(first) & ~np.isnan(second)
    a, b = first[both], second[both]
    square = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / square if square else math.nan


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the fitted settings and the comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.map_errors",
        description="Fit the model of a map's errors to perception=lidar, and compare the two.",
    )
    parser.add_argument("overrides", nargs="*", default=["perception.pose=matched"])
    parser.add_argument("--terrain", default="step,stair,rubble", help="families [%(default)s]")
    parser.add_argument("--episodes", type=int, default=3, help="of each family [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="seed of the episodes [0]")
    chosen = parser.parse_args(arguments)
    plugins.load([])
    common = [f"terrain={chosen.terrain}", f"eval.episodes={chosen.episodes}"]
    lidar = [*common, "perception=lidar", *chosen.overrides]
    recorded = _record(lidar, chosen.seed + FITTED)
    for kind in (Errors.level, Errors.sloped):
        if np.isnan(_all(kind, recorded)).all():
            raise RequestError(
                f"--terrain {chosen.terrain}: no {kind.__name__} ground is on it; both are needed"
            )
    size = fit(recorded)
    modelled = _record([*common, *_words(size)], chosen.seed + FITTED)
    size = with_jitter(size, recorded, modelled)
    modelled = _record([*common, *_words(size)], chosen.seed + FITTED)
    factor = scale(recorded, modelled)
    size = replace(size, drift=size.drift * factor, jitter=size.jitter * factor)
    print(*_words(size), flush=True)
    model = [*common, *_words(size)]
    seed = chosen.seed + COMPARED
    for name, words in (("lidar", lidar), ("model", model)):
        _describe(name, _record(words, seed))
    for policy in ("okada", "generalist"):
        for name, words in (("true ground", common), ("lidar", lidar), ("model", model)):
            _print_variation(policy, name, [*words, f"eval.seed={seed}"])
    return 0


def _words(size: MapErrorSize) -> list[str]:
    """Return the overrides that choose the model."""
    return [
        f"perception.map_error={size.height:.4f}",
        f"perception.map_length={size.length:.3f}",
        f"perception.map_drift={size.drift:.4f}",
        f"perception.map_jitter={size.jitter:.4f}",
        "perception.occlusion=true",
    ]


def _record(words: Sequence[str], seed: int) -> list[Errors]:
    from flipperctl.requests.plan import scenes
    from flipperctl.requests.text import from_words

    found = []
    for config, source in scenes(from_words(words), None, "okada"):
        runner = EpisodeRunner(config, source, seed)
        found += [Errors.of(runner.transitions(i)[0]) for i in range(config.eval.episodes)]
    return found


def _describe(name: str, recorded: Sequence[Errors]) -> None:
    for kind, errors in (
        ("all", [e.error for e in recorded]),
        ("level", [e.level() for e in recorded]),
        ("sloped", [e.sloped() for e in recorded]),
    ):
        values = np.concatenate([e.ravel() for e in errors])
        values = 1000 * values[~np.isnan(values)]  # [mm]
        quantiles = " ".join(f"{q:6.1f}" for q in np.quantile(values, QUANTILES))
        along = " ".join(f"{correlation_along(errors, lag):5.2f}" for lag in LAGS)
        time = " ".join(f"{correlation_in_time(errors, lag):5.2f}" for lag in LAGS)
        print(
            f"{name} {kind:6} n {len(values):5} RMS {np.sqrt((values**2).mean()):5.1f} mm, "
            f"quantiles {quantiles}; correlation at {LAGS} bins {along}, decisions {time}"
        )


def _print_variation(policy: str, name: str, words: Sequence[str]) -> None:
    from flipperctl.requests.plan import scenes
    from flipperctl.requests.text import from_words

    rule = policy == "okada"
    found = scenes(from_words(words), None if rule else Path(policy), policy if rule else None)
    cells = []
    for played in evaluate(Plan.of_one([Entry(*scene) for scene in found])).played:
        reached = played.episodes.reached
        variation = (
            f"{np.mean(reached.values('pitch_variation_decisions')):.2f}" if reached else "–"
        )
        cells.append(f"{played.entry.terrain} {len(reached)}/{len(played.episodes)} {variation}")
    print(f"{policy} on {name}: θ̂_R at decisions [rad] {', '.join(cells)}", flush=True)


if __name__ == "__main__":
    entry.run(main)
