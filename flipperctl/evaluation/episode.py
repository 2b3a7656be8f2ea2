"""The result of one episode of an evaluation.

In: the flat row that ``rollout.episode.play`` returns. Out: the same numbers as typed fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from flipperctl.api import Outcome
from flipperctl.checkpoint.recording import RecordedEpisode
from flipperctl.env.metrics import DRAWN, other_measures
from flipperctl.rollout.episode import SEARCH
from flipperctl.rollout.risks import EpisodeRisks

_REWARD = "reward_"
"""Prefix of the columns of reward terms."""


@dataclass(frozen=True)
class EpisodeResult:
    """The outcome, the measures and the sampled values of one episode."""

    episode: int
    """Index of the episode in the evaluation, from 0."""
    seed: int
    """Seed of the episode; equal seeds give equal ground and an equal start for every policy."""
    outcome: Outcome
    terrain: str
    """Label of the sampled profile; for a mix, that of the chosen part."""
    decisions: int
    t_cost: float
    """Time to the end of the episode [s]."""
    pitch_variation: float
    """θ̂_R, the sum of the pitch's absolute changes between decisions [rad] (paper Eq. 8)."""
    pitch_variation_100hz: float
    """Sum of the pitch's absolute changes between samples 10 ms apart [rad]."""
    max_pitch: float
    """Largest absolute pitch [rad]."""
    flipper_travel: float
    """Sum of both flipper pairs' absolute changes of angle between decisions [rad]."""
    episode_return: float
    """Sum of all weighted reward terms over the episode [-]."""
    rewards: Mapping[str, float]
    """Each term's weighted part of the return [-]."""
    sampled: Mapping[str, float]
    """Values sampled for the start and for the settings of ``randomise``, by name; SI units."""
    further: Mapping[str, float] = field(default_factory=dict)
    """Measures beyond those above, by name, in their own units."""
    search: Mapping[str, float | str] = field(default_factory=dict)
    """Values that the policy reported about its search, by name; empty without a search."""
    drawn: Mapping[str, float] = field(default_factory=dict)
    """Numbers that the terrain drew, by name, in the units of its settings."""
    static_bound: float | None = None
    """Static lower bound of θ̂_R on this ground [rad]; None if it was not computed."""
    crossed_by: str | None = None
    """Label of a policy that reached the finish with this seed; empty if none did, None if no other
    policy tried."""
    failed_by: str | None = None
    """What the failure is due to, a ``SensingCause``; None if it reached or was not looked into."""
    risks: EpisodeRisks | None = None
    """The risk that the policy told at each decision; None for a policy that tells none."""
    digest: str | None = field(default=None, compare=False, repr=False)
    """Digest of the actions and of the poses at 100 Hz; None if it was not computed."""
    recorded: RecordedEpisode | None = field(default=None, compare=False, repr=False)
    """The episode decision by decision, if recording was requested."""

    @classmethod
    def of(cls, episode: int, row: Mapping[str, Any], digest: str | None = None) -> EpisodeResult:
        """Return the result from a row of ``rollout.episode.play`` and the episode's digest.

        Raises:
            KeyError: the row lacks a measure.
        """
        rest = dict(row)
        risks = EpisodeRisks.pop(rest)
        search = {n.removeprefix(SEARCH): rest.pop(n) for n in row if n.startswith(SEARCH)}
        drawn = {n.removeprefix(DRAWN): rest.pop(n) for n in row if n.startswith(DRAWN)}
        names = (m.plugin_name for m in other_measures())
        further = {name: rest.pop(name) for name in names if name in rest}
        return cls(
            episode,
            seed=rest.pop("seed"),
            outcome=Outcome(rest.pop("outcome")),
            terrain=rest.pop("terrain"),
            decisions=rest.pop("decisions"),
            t_cost=rest.pop("t_cost"),
            pitch_variation=rest.pop("pitch_variation"),
            pitch_variation_100hz=rest.pop("pitch_variation_100hz"),
            max_pitch=rest.pop("max_pitch"),
            flipper_travel=rest.pop("flipper_travel"),
            episode_return=rest.pop("return"),
            rewards={n.removeprefix(_REWARD): rest.pop(n) for n in row if n.startswith(_REWARD)},
            sampled=rest,
            further=further,
            search=search,
            drawn=drawn,
            risks=risks,
            digest=digest,
        )

    @property
    def reached(self) -> bool:
        """True if the robot reached the finish."""
        return self.outcome is Outcome.REACHED

    def number(self, name: str) -> float | None:
        """Return a number that the terrain drew, or else a sampled value; None if there is none."""
        return self.drawn.get(name, self.sampled.get(name))

    def row(self) -> dict[str, Any]:
        """Return the flat row of ``episodes.csv``, with keys in the order of the columns."""
        return {
            "episode": self.episode,
            "seed": self.seed,
            "outcome": str(self.outcome),
            "terrain": self.terrain,
            "decisions": self.decisions,
            "t_cost": self.t_cost,
            "pitch_variation": self.pitch_variation,
            "pitch_variation_100hz": self.pitch_variation_100hz,
            "max_pitch": self.max_pitch,
            "flipper_travel": self.flipper_travel,
            **self.further,
            "return": self.episode_return,
            **{f"{_REWARD}{name}": value for name, value in self.rewards.items()},
            **self.sampled,
            **{f"{DRAWN}{name}": value for name, value in self.drawn.items()},
            **({} if self.static_bound is None else {"static_bound": self.static_bound}),
            **{f"{SEARCH}{name}": value for name, value in self.search.items()},
            **({} if self.crossed_by is None else {"crossed_by": self.crossed_by}),
            **({} if self.failed_by is None else {"failed_by": self.failed_by}),
            **({} if self.risks is None else self.risks.to_row()),
        }
