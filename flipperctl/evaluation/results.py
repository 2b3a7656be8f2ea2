"""The results of an evaluation, from an interval to the whole; each as plain data for JSON.

The keys of ``container()`` are those of ``eval --json`` and ``summary.json``, in their order.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from flipperctl.api import Outcome
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % bootstrap interval, in the unit of the values."""

    mean: float
    low: float
    high: float

    def container(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


@dataclass(frozen=True)
class Measure(Interval):
    """A measure over episodes: times [s], angles [rad], returns [-]."""

    range: float
    """Largest value less the smallest."""


@dataclass(frozen=True)
class PairedDifference(Interval):
    """The mean difference, a policy's value less its baseline's, over equal seeds."""

    episodes: int
    """Seeds with which both reached the finish."""


@dataclass(frozen=True)
class Outcomes:
    """How many episodes ended in which way."""

    reached: int
    overturned: int
    stuck: int
    timeout: int

    @classmethod
    def of(cls, outcomes: Iterable[Outcome]) -> Outcomes:
        """Count the outcomes."""
        counts = Counter(outcomes)
        return cls(**{str(outcome): counts[outcome] for outcome in Outcome})

    def container(self) -> dict[str, int]:
        """Return the counts by outcome, those of 0 too."""
        return asdict(self)


@dataclass(frozen=True)
class Passable:
    """Success over the episodes that some policy is known to cross."""

    episodes: int
    """How many episodes these are."""
    success_rate: float | None
    """None if there is no such episode."""
    success: Interval | None

    def container(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "success": _data(self.success),
        }


@dataclass(frozen=True)
class Summary:
    """The episodes of one policy on one terrain, summed up.

    ``t_cost``, ``pitch_variation``, ``pitch_variation_100hz`` and ``flipper_travel`` are of the
    episodes that reached the finish, and None if none did.
    """

    terrain: str
    episodes: int
    success_rate: float
    success: Interval
    outcomes: Outcomes
    t_cost: Measure | None
    """[s]"""
    pitch_variation: Measure | None
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: Measure | None
    """θ̂_R at samples 10 ms apart [rad]."""
    flipper_travel: Measure | None
    """[rad]"""
    max_pitch: Measure
    """[rad]"""
    episode_return: Measure
    """[-]"""
    passable: Passable | None
    """None if no other policy was asked to cross what this one did not."""
    further: Mapping[str, Measure | None]
    """Measures beyond those above, by name."""
    parts: Mapping[str, Summary]
    """Where several kinds of terrain were sampled, the summary of each by its label; else empty."""

    def container(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "terrain": self.terrain,
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "success": self.success.container(),
            "outcomes": self.outcomes.container(),
            "t_cost": _data(self.t_cost),
            "pitch_variation": _data(self.pitch_variation),
            "pitch_variation_100hz": _data(self.pitch_variation_100hz),
            "flipper_travel": _data(self.flipper_travel),
            **{name: _data(found) for name, found in self.further.items()},
            **({"passable": self.passable.container()} if self.passable else {}),
            "max_pitch": self.max_pitch.container(),
            "return": self.episode_return.container(),
            **_parts(self.parts),
        }


@dataclass(frozen=True)
class Differences:
    """A policy less its baseline, seed by seed; None where both reached the finish with none."""

    t_cost: PairedDifference | None
    """[s]"""
    pitch_variation: PairedDifference | None
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: PairedDifference | None
    """θ̂_R at samples 10 ms apart [rad]."""
    parts: Mapping[str, Differences]
    """Where several kinds of terrain were sampled, those of each by its label; else empty."""

    def container(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "t_cost": _data(self.t_cost),
            "pitch_variation": _data(self.pitch_variation),
            "pitch_variation_100hz": _data(self.pitch_variation_100hz),
            **_parts(self.parts),
        }


@dataclass(frozen=True)
class BaselineResult:
    """A baseline in the same episodes of a scene, and the policy's differences to it."""

    controller: str
    summary: Summary
    difference: Differences
    episodes: tuple[EpisodeResult, ...]

    def container(self) -> dict[str, Any]:
        """Return plain data, without the single episodes."""
        return {
            "controller": self.controller,
            **self.summary.container(),
            "difference": self.difference.container(),
        }


@dataclass(frozen=True)
class SceneResult:
    """A policy on one terrain under one set of conditions."""

    summary: Summary
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    baseline: BaselineResult | None
    episodes: tuple[EpisodeResult, ...]

    @property
    def terrain(self) -> str:
        """Name of the terrain plugin."""
        return self.summary.terrain

    def container(self) -> dict[str, Any]:
        """Return plain data, without the single episodes."""
        return {
            **self.summary.container(),
            "seed": self.seed,
            "conditions": self.conditions.container(),
            **({"baseline": self.baseline.container()} if self.baseline else {}),
        }


@dataclass(frozen=True)
class EvaluationResult:
    """A policy on all its scenes."""

    controller: str
    """Label of the policy."""
    scenes: tuple[SceneResult, ...]

    def container(self) -> dict[str, Any]:
        """Return plain data, without the single episodes."""
        return {
            "controller": self.controller,
            "scenes": [scene.container() for scene in self.scenes],
        }

    def to_json(self) -> str:
        """Return the document of ``eval --json``."""
        return json.dumps(self.container(), indent=2)


def _data(interval: Interval | None) -> dict[str, float] | None:
    return None if interval is None else interval.container()


def _parts(parts: Mapping[str, Summary] | Mapping[str, Differences]) -> dict[str, Any]:
    """Return the entry ``parts``, which is there only if there are any."""
    return {"parts": {label: p.container() for label, p in parts.items()}} if parts else {}
