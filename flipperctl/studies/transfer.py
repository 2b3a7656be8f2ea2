"""Evaluate a policy in the default engine and in another one, and explain its failures there.

In: an evaluation's configuration in the other engine, and a policy. Out: the summaries of both, the
differences at equal seeds, and the cause of each failure. A sensor that is not that of the true
ground, such as ``lidar``, adds a third step: both engines are then compared on the true ground, and
the other engine with the sensor to itself without.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from flipperctl.config import DEFAULT_ENGINE, EvalConfig
from flipperctl.evaluation.comparisons import correct_together
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import PairedSuccess
from flipperctl.evaluation.judging import Progress, no_progress, play_scene
from flipperctl.evaluation.results import Differences, Summary
from flipperctl.evaluation.scenes import Scene
from flipperctl.evaluation.sensing import SensingCause, causes, on_true_ground
from flipperctl.evaluation.statistics import differences, summarise
from flipperctl.evaluation.workers import EpisodeWorkers
from flipperctl.policies.source import PolicySource
from flipperctl.studies.engines import in_default_engine
from flipperctl.studies.failures import Failure, explain


@dataclass(frozen=True)
class SensedResult:
    """The same episodes in the other engine with the sensor in place of the true ground."""

    sensor: str
    """Name of the sensor."""
    summary: Summary
    gap: Differences
    """With the sensor minus on the true ground, both in the other engine."""
    kept: float | None
    """Fraction of the episodes crossed on the true ground that are crossed with the sensor."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        gap, summary = self.gap.to_dict(), self.summary.to_dict()
        return {"sensor": self.sensor, "summary": summary, "gap": gap, "kept": self.kept}


@dataclass(frozen=True)
class TransferResult:
    """A policy on one terrain in two engines, and with a sensor that maps the ground if asked."""

    controller: str
    """Label of the policy."""
    terrain: str
    engines: tuple[str, str]
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    """Conditions of the other engine, with the sensor."""
    default: Summary
    other: Summary
    """With ``sensed``: on the true ground, like ``default``."""
    kept: float | None
    """Fraction of the episodes crossed in the default engine that are crossed in the other one."""
    gap: Differences
    """The other engine minus the default one: success, and measures where both reached the
    finish."""
    failures: tuple[Failure, ...]
    """In the other engine, with the sensor if there is one."""
    sensed: SensedResult | None = None
    """None: both engines perceived in the same way."""

    @property
    def success_gap(self) -> PairedSuccess:
        """Success in the other engine minus that in the default one, paired by seed [-]."""
        return self.gap.success

    @property
    def causes(self) -> dict[str, int]:
        """Number of failures by cause, the most frequent first."""
        return dict(Counter(str(f.cause) for f in self.failures).most_common())

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        first, second = self.engines
        return {
            "terrain": self.terrain,
            "controller": self.controller,
            "engines": [first, second],
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            first: self.default.to_dict(),
            second: self.other.to_dict(),
            "success_gap": self.success_gap.to_dict(),
            "kept": self.kept,
            "gap": self.gap.to_dict(),
            **({"sensed": self.sensed.to_dict()} if self.sensed else {}),
            "causes": self.causes,
            "failures": [failure.to_dict() for failure in self.failures],
        }


def transfer(
    config: EvalConfig,
    source: PolicySource,
    workers: EpisodeWorkers,
    *,
    only: Sequence[int] | None = None,
    progress: Progress = no_progress,
) -> TransferResult:
    """Play the evaluation's episodes in the default engine and in ``config``'s.

    With a sensor such as ``lidar``, these two perceive the true ground, and ``config``'s engine
    plays them once more with the sensor.

    ``workers`` play the episodes, those with the indices ``only``; None means all.

    Raises:
        ConfigError: ``config`` uses the default engine.
        FlipperctlError: the policy cannot be built or failed.
    """
    exact = on_true_ground(config)
    truly = config if exact is None else exact
    terrain, engines = config.terrain.plugin_name, (DEFAULT_ENGINE, config.sim.plugin_name)

    def played(
        chosen: EvalConfig, where: str, indices: Sequence[int] | None
    ) -> list[EpisodeResult]:
        return play_scene(chosen, source, f"{terrain}, {where}", workers, progress, indices)

    ours = played(in_default_engine(truly), engines[0], only)
    theirs = last = played(truly, engines[1], only)
    sensed, blamed = None, dict[int, SensingCause]()
    if exact is not None:
        sensor = config.perception.plugin_name
        last = played(config, sensor, only)
        gap = differences(last, theirs)
        sensed = SensedResult(sensor, summarise(terrain, last), gap, _kept(theirs, last))
        failed = [e for e in last if not e.reached]
        blamed = causes(config, failed, lambda c, i: played(c, f"{sensor}, again", i), theirs)
    return TransferResult(
        source.label(),
        terrain,
        engines,
        config.eval.seed,
        Conditions.of(config),
        summarise(terrain, ours),
        summarise(terrain, theirs),
        _kept(ours, theirs),
        differences(theirs, ours),
        tuple(
            explain(config, source, first, end, blamed.get(end.episode, SensingCause.OTHER))
            for first, end in zip(ours, last, strict=True)
            if not end.reached
        ),
        sensed,
    )


def _kept(first: Sequence[EpisodeResult], then: Sequence[EpisodeResult]) -> float | None:
    """Return the fraction of the episodes reached at first that are reached then."""
    crossed = [b.reached for a, b in zip(first, then, strict=True) if a.reached]
    return sum(crossed) / len(crossed) if crossed else None


def transfer_scenes(
    scenes: Sequence[Scene],
    workers: EpisodeWorkers,
    only: int | None = None,
    progress: Progress = no_progress,
) -> list[TransferResult]:
    """Return the result of each scene, its tests corrected for all; ``only``: of one episode."""
    chosen = None if only is None else [only]
    return correct_scenes(
        [transfer(c, source, workers, only=chosen, progress=progress) for c, source in scenes]
    )


def correct_scenes(found: Sequence[TransferResult]) -> list[TransferResult]:
    """Return the results with the p-values of success corrected across scenes."""
    sensed = [one.sensed for one in found if one.sensed is not None]
    gaps = iter(correct_together([*(o.gap for o in found), *(o.gap for o in sensed)]))
    corrected = [replace(one, gap=next(gaps)) for one in found]
    return [
        one if one.sensed is None else replace(one, sensed=replace(one.sensed, gap=next(gaps)))
        for one in corrected
    ]
