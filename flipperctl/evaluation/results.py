"""The results of an evaluation as typed values that convert to plain data for JSON.

``to_dict()`` has the keys of ``eval --json`` and ``summary.json``, in their order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from flipperctl.api import Outcome
from flipperctl.evaluation import plain
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.evaluation.estimates import Estimate, Interval, PairedDifference, PairedSuccess
from flipperctl.evaluation.failed_policies import Failure
from flipperctl.evaluation.interruption import Interruption
from flipperctl.evaluation.naming import NAMELESS, SceneName
from flipperctl.evaluation.risk import RiskSummary
from flipperctl.evaluation.sensing import counts


@dataclass(frozen=True)
class Outcomes:
    """The number of episodes with each outcome."""

    reached: int
    overturned: int
    stuck: int
    timeout: int

    @classmethod
    def of(cls, outcomes: Iterable[Outcome]) -> Outcomes:
        """Count the outcomes."""
        counts = Counter(outcomes)
        return cls(**{str(outcome): counts[outcome] for outcome in Outcome})

    def to_dict(self) -> dict[str, int]:
        """Return the counts by outcome, including zeros."""
        return asdict(self)


@dataclass(frozen=True)
class Passable:
    """Success over the episodes that a reference crosses, independent of the policy."""

    episodes: int
    """Number of these episodes."""
    success_rate: float | None
    """Fraction of them that the policy crossed, 0 to 1; None if there is no such episode."""
    success: Interval | None
    beyond: int
    """Number of further episodes that the policy crossed and no reference did."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


@dataclass(frozen=True)
class NotReached:
    """Measures over the episodes that did not reach the finish, from their start to their end."""

    episodes: int
    """Number of these episodes."""
    duration: Estimate
    """Time to the end of the episode [s]."""
    pitch_variation: Estimate
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: Estimate
    """θ̂_R at samples 10 ms apart [rad]."""
    flipper_travel: Estimate
    """Angle that both flipper pairs turned [rad]."""
    further: Mapping[str, Estimate] = field(default_factory=dict)
    """Further measures with ``reached_only``, by name."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        plain = asdict(self)
        further: dict[str, Any] = plain.pop("further")
        return {**plain, **further}


@dataclass(frozen=True)
class Summary:
    """The summary of one policy's episodes on one terrain.

    ``t_cost``, ``pitch_variation``, ``pitch_variation_100hz`` and ``flipper_travel`` are taken over
    the episodes that reached the finish, and are None if none did.
    """

    terrain: str
    episodes: int
    success_rate: float
    success: Interval
    outcomes: Outcomes
    t_cost: Estimate | None
    """Time from start to finish [s]."""
    pitch_variation: Estimate | None
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: Estimate | None
    """θ̂_R at samples 10 ms apart [rad]."""
    flipper_travel: Estimate | None
    """Angle that both flipper pairs turned [rad]."""
    max_pitch: Estimate
    """Largest absolute pitch [rad]."""
    episode_return: Estimate
    """Sum of all weighted reward terms over the episode [-]."""
    passable: Passable | None
    """Success on passable episodes; None if no reference policy was used."""
    further: Mapping[str, Estimate | None]
    """Further measures by name, in their own units."""
    parts: Mapping[str, Summary]
    """Summary of each kind of terrain by label; empty unless several kinds were sampled."""
    not_reached: NotReached | None = None
    """Measures of the other episodes; None if all reached the finish."""
    search: Mapping[str, float | Mapping[str, int]] = field(default_factory=dict)
    """Values that a policy reported about its searches, by name: the mean of numbers over episodes,
    and the count of each word."""
    static_bound: Estimate | None = None
    """Static lower bound of θ̂_R over the episodes that reached the finish [rad], if computed."""
    risk: RiskSummary | None = None
    """How the policy's risk fits the ends of the episodes; None for a policy that tells none."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "terrain": self.terrain,
            "episodes": self.episodes,
            "success_rate": self.success_rate,
            "success": self.success.to_dict(),
            "outcomes": self.outcomes.to_dict(),
            "t_cost": plain.data(self.t_cost),
            "pitch_variation": plain.data(self.pitch_variation),
            "pitch_variation_100hz": plain.data(self.pitch_variation_100hz),
            "flipper_travel": plain.data(self.flipper_travel),
            **({"static_bound": self.static_bound.to_dict()} if self.static_bound else {}),
            **{name: plain.data(found) for name, found in self.further.items()},
            **({"passable": self.passable.to_dict()} if self.passable else {}),
            "not_reached": self.not_reached.to_dict() if self.not_reached else None,
            "max_pitch": self.max_pitch.to_dict(),
            "return": self.episode_return.to_dict(),
            **({"search": dict(self.search)} if self.search else {}),
            **({"risk": self.risk.to_dict()} if self.risk else {}),
            **plain.parts(self.parts),
        }


@dataclass(frozen=True)
class Differences:
    """A policy minus its baseline over equal seeds; None if both reached with no seed."""

    success: PairedSuccess
    """Success over all seeds [-]."""
    t_cost: PairedDifference | None
    """Time from start to finish [s]."""
    pitch_variation: PairedDifference | None
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: PairedDifference | None
    """θ̂_R at samples 10 ms apart [rad]."""
    further: Mapping[str, PairedDifference | None]
    """Further measures by name, in their own units."""
    parts: Mapping[str, Differences]
    """Differences on each kind of terrain by label; empty unless several were sampled."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "success": self.success.to_dict(),
            "t_cost": plain.data(self.t_cost),
            "pitch_variation": plain.data(self.pitch_variation),
            "pitch_variation_100hz": plain.data(self.pitch_variation_100hz),
            **{name: plain.data(found) for name, found in self.further.items()},
            **plain.parts(self.parts),
        }


@dataclass(frozen=True)
class BaselineResult:
    """A baseline on a scene's episodes, and the policy's differences from it."""

    controller: str
    summary: Summary
    difference: Differences
    episodes: tuple[EpisodeResult, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, without individual episodes."""
        return {
            "controller": self.controller,
            **self.summary.to_dict(),
            "difference": self.difference.to_dict(),
        }


@dataclass(frozen=True)
class Group:
    """The episodes of a scene whose drawn numbers are alike."""

    ranges: Mapping[str, tuple[float, float]]
    """Smallest and largest value in the group of each number, by name, in the number's unit."""
    summary: Summary
    baselines: tuple[BaselineResult, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        ranges = {n: {"low": low, "high": high} for n, (low, high) in self.ranges.items()}
        return {"drawn": ranges, **self.summary.to_dict(), **plain.baselines(self.baselines)}


@dataclass(frozen=True)
class SceneResult:
    """A policy on one terrain under one set of conditions."""

    controller: str
    """Label of the policy."""
    summary: Summary
    seed: int
    """Seed of the evaluation."""
    conditions: Conditions
    baselines: tuple[BaselineResult, ...]
    episodes: tuple[EpisodeResult, ...]
    name: SceneName = NAMELESS
    """How the scene and the policy are called among several methods."""
    by: Mapping[str, tuple[Group, ...]] = field(default_factory=dict)
    """Groups of the episodes by a drawn number, such as ``steps``, or several (``steps+up``)."""
    index: int | None = None
    """Place among the scenes that were evaluated; None for a row beside them, of other results."""

    @property
    def terrain(self) -> str:
        """Name of the terrain plugin."""
        return self.summary.terrain

    @property
    def method(self) -> str:
        """Name of the policy for tables: that of its method with the training seed, if known."""
        return self.name.method_text or self.controller

    @property
    def row_label(self) -> str:
        """Label of the policy in files: that of a row beside the evaluated ones says so."""
        return self.method if self.index is None else self.controller

    @property
    def has_identical_episodes(self) -> bool:
        """Whether there are several episodes whose outcomes and measures are all identical."""
        measured = {
            (e.outcome, e.t_cost, e.pitch_variation_100hz, e.max_pitch, e.episode_return)
            for e in self.episodes
        }
        return len(self.episodes) > 1 == len(measured)

    @property
    def finished(self) -> int:
        """Number of episodes of the policy and its baselines."""
        return len(self.episodes) + sum(len(other.episodes) for other in self.baselines)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, without individual episodes."""
        return {
            **self.summary.to_dict(),
            "controller": self.controller,
            "seed": self.seed,
            "conditions": self.conditions.to_dict(),
            **({"failed_by": failed} if (failed := counts(self.episodes)) else {}),
            **self.name.to_dict(),
            **plain.baselines(self.baselines),
            **({"by": plain.groups(self.by)} if self.by else {}),
        }


@dataclass(frozen=True)
class EvaluationResult:
    """Results of policies on their scenes, usually of one policy on several."""

    scenes: tuple[SceneResult, ...]
    """Scenes with a finished episode."""
    interruption: Interruption | None = None
    """None if every episode was played."""
    failures: tuple[Failure, ...] = ()
    """Policies, baselines and references that failed on a scene; their results are left out."""

    @property
    def controller(self) -> str:
        """Label of the policy; several are separated by commas."""
        return ", ".join(dict.fromkeys(scene.controller for scene in self.scenes))

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, without individual episodes."""
        stopped = self.interruption
        return {
            "controller": self.controller,
            **({} if stopped is None else stopped.to_dict()),
            **({"failed": [f.to_dict() for f in self.failures]} if self.failures else {}),
            "scenes": [scene.to_dict() for scene in self.scenes],
        }
