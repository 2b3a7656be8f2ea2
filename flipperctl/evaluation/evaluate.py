"""Evaluate a plan: play what the store lacks, and return the episodes of each of its entries.

In: a plan. Out: a ``Result``, from which views are made by pure functions; nothing is printed or
written here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from flipperctl.config import EvalConfig
from flipperctl.errors import FlipperctlError, InterruptedRunError
from flipperctl.evaluation.failure_causes import causes
from flipperctl.evaluation.plan import RULES, Entry, Plan
from flipperctl.evaluation.play import NOT_A_POLICYS, Player, Progress, no_progress
from flipperctl.evaluation.rows import Episodes, reached
from flipperctl.evaluation.store import EpisodeStore
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.policies.source import PolicySource

_SHOWN = 12  # largest number of scenes that the sentence on an interruption names


@dataclass(frozen=True)
class Played:
    """The episodes of one entry of a plan."""

    entry: Entry
    episodes: Episodes
    policy: PolicyIdentity | None = None
    """The policy as it was when it played; None for stored episodes of another one."""


def _rank(played: Played) -> int:
    """Return the place among the usual baselines; a policy that is none comes behind them."""
    name = played.entry.method
    return RULES.index(name) if name in RULES else len(RULES)


@dataclass(frozen=True)
class Interruption:
    """The finished part of an interrupted evaluation, baselines included."""

    finished: int
    """Number of finished episodes."""
    planned: int
    """Number of episodes that were planned."""
    not_begun: tuple[str, ...]
    """Scenes without a finished episode."""

    @property
    def text(self) -> str:
        """One sentence for the user."""
        begun = f"interrupted: {self.finished} of {self.planned} episodes are finished"
        if not self.not_begun:
            return begun
        more = len(self.not_begun) - _SHOWN
        named = ", ".join(self.not_begun[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
        return f"{begun}; not begun: {named}"


@dataclass(frozen=True)
class PolicyError:
    """A policy that could not play all episodes of a scene."""

    controller: str
    """Label of the policy."""
    terrain: str
    error: FlipperctlError


@dataclass(frozen=True)
class Result:
    """The episodes of a plan, as far as they were played."""

    plan: Plan
    played: tuple[Played, ...]
    """The entries with a finished episode, in the order of the plan."""
    interruption: Interruption | None = None
    """None if every episode was played."""
    failures: tuple[PolicyError, ...] = ()
    """Policies that failed on a scene; their episodes are left out, since the rest would favour
    them."""
    references: tuple[str, ...] = ()
    """Labels of the policies that determine which episodes can be crossed."""

    @property
    def rows(self) -> list[Played]:
        """The scenes of the result; baselines are so beside several methods."""
        methods = self.plan.has_methods
        return [item for item in self.played if methods or not item.entry.is_baseline]

    def baselines(self, played: Played) -> list[Played]:
        """Return the baselines on the episodes of a policy, of its rewards if there are such.

        A rule that is usual as a baseline is one where it is named, too, unless none are wanted.
        """
        by_label: dict[str, Played] = {}
        if played.entry.is_baseline or played.entry.stored:
            return []
        for other in self.played:
            named = self.plan.has_baselines and _rank(other) < _rank(played)
            if (other.entry.is_baseline or named) and other.entry.ground == played.entry.ground:
                same = other.entry.config.rewards == played.entry.config.rewards
                if other.entry.label not in by_label or same:
                    by_label[other.entry.label] = other
        return list(by_label.values())

    def error(self) -> FlipperctlError | None:
        """Return the error of an evaluation in which policies failed; None if none did."""
        if not self.failures:
            return None
        first = self.failures[0]
        text = f"{first.controller} failed on {first.terrain}: {first.error}"
        if len(self.failures) > 1:
            text += f"; {len(self.failures) - 1} more failed"
        return type(first.error)(f"{text}; all other results are complete")


def evaluate(
    plan: Plan,
    *,
    references: Sequence[PolicySource] = (),
    progress: Progress = no_progress,
    record: bool = False,
    explain: bool = True,
    stop: Callable[[], bool] = lambda: False,
    store: EpisodeStore | None = None,
    planned: Callable[[int], None] = lambda episodes: None,
) -> Result:
    """Play the episodes of a plan, in as many processes as its scenes ask for.

    ``references``, controllers or policies of the plan, determine which episodes can be crossed at
    all: each plays those that no earlier one crossed. ``record``: whether rows include the
    decisions. ``explain``: whether failures are played again for their cause. Once ``stop``, called
    before each episode, returns True, the evaluation ends with the finished episodes. Episodes that
    the ``store`` has are not played again; new ones are added to it. ``planned`` is called once
    with the number of episodes that the store lacks. A policy that fails on a scene is listed in
    ``failures``; if every policy fails, the first error is raised.
    """
    if not plan.entries:
        raise ValueError("an evaluation needs at least one scene")
    results: list[Played] = []
    failures: list[PolicyError] = []
    with Player(store, progress, stop) as player:
        # How much there is to play, before any of it is played
        planned(_lacking(player, plan.entries))
        address = plan.entries[0].config.eval.ray
        if address is not None and not record:
            player.play_over_ray([(e.config, e.source) for e in plan.entries], address)
        # For each entry its episodes, why some failed, and whether anybody crosses them
        for entry in plan.entries:
            if entry.is_baseline and not any(p.entry.ground == entry.ground for p in results):
                continue  # there is nothing to compare with it
            scene = _Scene(entry, player, failures)
            named = plan.has_methods or entry.is_baseline
            label = f"{entry.terrain}, {entry.named}" if named else entry.terrain
            rows = scene.play(entry.source, label, record=record and not entry.is_baseline)
            if rows and (plan.has_methods or not entry.is_baseline):
                rows = scene.with_causes(rows) if explain else rows
                rows = scene.with_references(rows, plan, references)
            if rows:
                results.append(Played(entry, rows, player.identity(entry.source)))
    # Policies that fail are listed; nothing but failures is an error.
    if failures and all(result.entry.is_baseline for result in results):
        raise failures[0].error
    interruption = _interruption(plan, results) if player.interrupted else None
    labels = tuple(reference.label() for reference in references)
    return Result(plan, tuple(results), interruption, tuple(failures), labels)


def _lacking(player: Player, entries: Iterable[Entry]) -> int:
    """Return the number of episodes that the store lacks, without the references' episodes."""
    episodes_left: set[tuple[str, int]] = set()
    for entry in entries:
        with suppress(FlipperctlError):  # which playing raises again, where it is noted
            key = player.key(entry.config, entry.source).text
            missing = player.missing(entry.config, entry.source)
            episodes_left |= {(key, index) for block in missing for index in block}
    return len(episodes_left)


def _interruption(plan: Plan, played: Sequence[Played]) -> Interruption:
    """Return the finished and planned episodes of the policies and their baselines."""
    planned = sum(entry.config.eval.episodes for entry in plan.entries)
    finished = sum(len(entry_played.episodes) for entry_played in played)
    if not finished:
        raise InterruptedRunError(f"interrupted: none of {planned} episodes is finished")
    several = any(entry.source != plan.rows[0].source for entry in plan.rows)
    begun = {id(entry_played.entry) for entry_played in played}
    left = [entry for entry in plan.rows if id(entry) not in begun]
    names = [f"{entry.label} on {entry.terrain}" if several else entry.terrain for entry in left]
    return Interruption(finished, planned, tuple(names))


@dataclass
class _Scene:
    """The scene of an entry, played by several policies."""

    entry: Entry
    player: Player
    failures: list[PolicyError]
    """Takes each policy that fails on the scene."""

    def play(
        self,
        source: PolicySource,
        label: str,
        indices: Sequence[int] | None = None,
        config: EvalConfig | None = None,
        *,
        record: bool = False,
    ) -> Episodes:
        """Return the episodes of a policy; none of one that fails, since the rest would favour it.

        ``config``: another sensing of the same episodes.
        """
        try:
            scene_config = config or self.entry.config
            return self.player.play(scene_config, source, label, indices, record=record)
        except NOT_A_POLICYS:
            raise
        except FlipperctlError as error:
            self.failures.append(PolicyError(source.label(), self.entry.terrain, error))
            return Episodes()

    def with_causes(self, episodes: Episodes) -> Episodes:
        """Return the episodes, the failed ones with their cause if the sensor maps the ground."""
        entry = self.entry
        label = f"{entry.terrain}, failed episodes again"

        def again(config: EvalConfig, indices: Sequence[int]) -> Episodes:
            return self.play(entry.source, label, indices, config)

        if self.player.interrupted:
            return episodes
        cause_of = causes(entry.config, episodes.failed, again)
        return _with(episodes, "failed_by", {at: str(cause) for at, cause in cause_of.items()})

    def with_references(
        self, episodes: Episodes, plan: Plan, references: Sequence[PolicySource]
    ) -> Episodes:
        """Return the episodes, each with the first reference that crosses it, or an empty text.

        A reference of the ``plan`` plays as it does there. The episodes stay as they are if a
        reference was stopped or failed, since untried episodes are then unknown.
        """
        failed = len(self.failures)
        crossed = dict.fromkeys(range(self.entry.config.eval.episodes), "")
        for reference in references:
            name, indices = reference.label(), [index for index, by in crossed.items() if not by]
            config = plan.config_of(reference, self.entry)
            # A reference has stored episodes at no cost, also those that others crossed.
            with suppress(FlipperctlError):  # which playing raises again, where it is noted
                if not self.player.missing(config, reference):
                    indices = list(crossed)
            label = f"{self.entry.terrain}, {name} on episodes not crossed yet"
            for row in self.play(reference, label, indices, config):
                if reached(row):
                    crossed[row["episode"]] = crossed[row["episode"]] or name
        whole = not self.player.interrupted and len(self.failures) == failed
        return _with(episodes, "crossed_by", crossed) if references and whole else episodes


def _with(episodes: Episodes, column: str, values: Mapping[int, str]) -> Episodes:
    """Return the episodes with a further column, by their index."""
    additions = (
        {column: values[at]} if (at := row["episode"]) in values else {} for row in episodes
    )
    return Episodes(tuple(row | more for row, more in zip(episodes, additions, strict=True)))
