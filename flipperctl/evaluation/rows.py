"""The episode table: a flat row for each episode that was played.

In: rows of ``rollout.episode.play``. Out: ``Episodes``, which views select, group and pair. A row
has the columns of ``episodes.csv``: the episode's index and seed, its outcome, measures, rewards
and drawn values, in SI units. Equal episodes, bit for bit, have an equal ``digest``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.env.metrics import CORE, DRAWN, other_measures
from flipperctl.rollout.episode import SEARCH

Row = dict[str, Any]
DIGEST = "digest"
RECORDED = "recorded"
"""Column of an episode's decisions, if it was played to be recorded; it is never stored."""
REWARD = "reward_"  # prefix of the columns of reward terms
_FIRST = ("episode", "seed", "outcome", "terrain", *CORE)
CAUSE = "cause"  # column of the cause of a failure, where engines are compared
END = {name: f"end_{name}" for name in ("x", "pitch", "roll", "yaw", "side")}
"""Columns of the robot's posture at the end of such a failure; [m] and [rad]."""
_LAST = (
    "crossed_by",
    "failed_by",
    CAUSE,
    *END.values(),
    "risk_horizon",
    "risk_threshold",
    "risks",
)
_MOST_BINS = 8
"""Largest number of different values that have a group each; more are split at their quartiles."""


def arranged(row: Mapping[str, Any]) -> Row:
    """Return a row with its columns in the order of ``episodes.csv``."""
    measures = [cls.plugin_name for cls in other_measures()]
    # Known columns have their place; the terrain's, the search's and the sampled ones follow.
    known = {*_FIRST, *measures, "return", *_LAST}
    prefixes = (REWARD, DRAWN, SEARCH)
    rest = [name for name in row if name not in known]
    parts = {prefix: [name for name in rest if name.startswith(prefix)] for prefix in prefixes}
    drawn_values = [name for name in rest if not name.startswith(prefixes)]
    order = [
        *_FIRST,
        *measures,
        "return",
        *parts[REWARD],
        *drawn_values,
        *parts[DRAWN],
        *parts[SEARCH],
    ]
    return {name: row[name] for name in (*order, *_LAST) if name in row}


def sampled(row: Mapping[str, Any]) -> dict[str, float]:
    """Return the values that were sampled for the start and by ``randomise``, by name; SI units."""
    known = {*_FIRST, *_LAST, "return", DIGEST, RECORDED}
    known |= {cls.plugin_name for cls in other_measures()}
    prefixes = (REWARD, DRAWN, SEARCH)
    return {n: v for n, v in row.items() if n not in known and not n.startswith(prefixes)}


def reached(row: Mapping[str, Any]) -> bool:
    """Return whether the episode reached the finish."""
    return bool(row["outcome"] == Outcome.REACHED)


def telling(episodes: Iterable[tuple[int, bool, float]]) -> int:
    """Return the index of the episode that shows most of several policies.

    Most of them reach its finish, and among such episodes their pitch varies most.

    Args:
        episodes: index, whether the finish was reached, and pitch variation [rad] of each episode
            of each policy.
    """
    finished, variations = Counter[int](), dict[int, float]()
    for index, good, variation in episodes:
        finished[index] += good
        variations[index] = variations.get(index, 0.0) + variation
    return max(sorted(finished), key=lambda index: (finished[index], variations[index]))


def number(row: Mapping[str, Any], name: str) -> float | None:
    """Return a number that the terrain drew, or else a sampled value; None if there is none."""
    value: float | None = row.get(f"{DRAWN}{name}", row.get(name))
    return value


@dataclass(frozen=True)
class Episodes(Sequence[Row]):
    """Rows of played episodes, usually of one policy on one scene."""

    rows: tuple[Row, ...] = ()

    def __getitem__(self, at: Any) -> Any:
        return Episodes(self.rows[at]) if isinstance(at, slice) else self.rows[at]

    def __len__(self) -> int:
        return len(self.rows)

    def where(self, accepts: Callable[[Row], bool]) -> Episodes:
        """Return the rows for which ``accepts`` is true."""
        return Episodes(tuple(row for row in self.rows if accepts(row)))

    @property
    def reached(self) -> Episodes:
        """The episodes that reached the finish."""
        return self.where(reached)

    @property
    def failed(self) -> Episodes:
        """The episodes that did not reach the finish."""
        return self.where(lambda row: not reached(row))

    def values(self, name: str) -> list[float]:
        """Return the numbers of a column, without the rows that lack it."""
        return [row[name] for row in self.rows if row.get(name) is not None]

    def columns(self, prefix: str) -> list[str]:
        """Return the names of the columns with a prefix, in their order, without it."""
        names = dict.fromkeys(n for row in self.rows for n in row if n.startswith(prefix))
        return [name.removeprefix(prefix) for name in names]

    def measures(self) -> list[Any]:
        """Return the classes of the measures beyond ``CORE`` that occur, sorted by name."""
        names = {name for row in self.rows for name in row}
        return [cls for cls in other_measures() if cls.plugin_name in names]

    def paired(self, others: Iterable[Row]) -> list[tuple[Row, Row]]:
        """Return the pairs of episodes of equal seeds."""
        by_seed = {row["seed"]: row for row in others}
        return [(row, by_seed[row["seed"]]) for row in self.rows if row["seed"] in by_seed]

    def kinds(self) -> dict[str, Episodes]:
        """Return the episodes of each kind of terrain by label, if there is more than one kind."""
        by_kind: dict[str, list[Row]] = {}
        for row in self.rows:
            by_kind.setdefault(row["terrain"], []).append(row)
        several = len(by_kind) > 1
        return {label: Episodes(tuple(by_kind[label])) for label in sorted(by_kind) if several}

    def binned(
        self, names: Sequence[str]
    ) -> Iterator[tuple[dict[str, tuple[float, float]], Episodes]]:
        """Yield the ranges of the numbers ``names`` in each group, and the group's episodes.

        A number with more than eight different values is split at its quartiles. Episodes without
        one of the numbers, such as other parts of a mix, are in no group.
        """
        # Only episodes with all of the numbers belong to a group.
        pairs = [(row, [number(row, name) for name in names]) for row in self.rows]
        whole = [(row, values) for row, values in pairs if None not in values]
        if not whole:
            return
        table = np.array([values for _, values in whole], dtype=float)  # (episodes, names)
        bins = np.column_stack([_bins(column) for column in table.T])
        # A group for each combination of bins that occurs
        for key in product(*(np.unique(column) for column in bins.T)):
            members = np.flatnonzero((bins == key).all(axis=1))
            if members.size:
                part = table[members]
                ends = zip(part.min(axis=0).tolist(), part.max(axis=0).tolist(), strict=True)
                ranges = dict(zip(names, ends, strict=True))
                yield ranges, Episodes(tuple(whole[at][0] for at in members))


def _bins(values: Any) -> Any:
    """Return the number of each value's bin, (K,)."""
    distinct, indices = np.unique(values, return_inverse=True)
    if len(distinct) <= _MOST_BINS:
        return indices
    return np.searchsorted(np.quantile(values, [0.25, 0.5, 0.75]), values, side="left")
