"""Tune a controller's numeric settings by CMA-ES (Hansen 2016) on episodes of trainings.

In: scenes with a controller, an objective, a budget of episodes. Out: settings, and their score
beside that of the start on episodes that neither search nor choice met. All candidates of a
generation play equal episodes, and each generation has its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flipperctl import __version__
from flipperctl.api import Controller
from flipperctl.config import resolver
from flipperctl.config.policy_file import PolicyFile, Score, Tuning
from flipperctl.errors import (
    ConfigError,
    InterruptedRunError,
    MissingExtraError,
    NonFiniteError,
    OutputError,
    RequestError,
)
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.seeds import (
    PRICE,
    Scores,
    SeedSamples,
    difference_interval,
    failure_prices,
    mean_interval,
    means,
)
from flipperctl.evaluation.statistics import Interval
from flipperctl.files import write_json
from flipperctl.messages import bounds, close_match, unit
from flipperctl.rollout.episode import training_seed
from flipperctl.show import Column, Table, interval_text

BUDGET, EPISODES = 5000, 20
"""Defaults: episodes of a search; of a candidate in a generation, on all scenes together."""
_LEAST, _FEWEST = 4, 5  # episodes of a candidate on a scene: in a generation, and at the end
_RECENT = 3  # generations whose best candidate is compared at the end
_FINALISTS = _RECENT + 2
_FINAL = 0.25  # share of the budget that the comparisons at the end take
_SPREAD = 0.2  # standard deviation of the first generation, as a fraction of each setting's range
_WIDE = 20  # range from which on a setting is searched on a logarithmic scale, in starts [-]
_TRIES = 1000  # samples after which a controller's own rules leave no valid candidate
_COLUMNS = (
    Column("setting", "setting", named=True),
    Column("before", "before", 3),
    Column("after", "after", 3),
    Column("bounds", "bounds"),
)

Objective = Literal["pitch", "reward"]
Fields = dict[str, float]
Measure = Callable[[Sequence[Fields], int, int, str], list[Scores]]
"""Plays candidates on the draws of a number, so many episodes on each scene, under a label; returns
the score of each candidate's episodes by scene, (1, E), of which less is better."""


@dataclass(frozen=True)
class Setting:
    """A bounded number of a controller."""

    name: str
    low: float
    high: float
    whole: bool
    scale: float = 0.0
    """Distance from ``low`` at which a logarithmic scale begins; 0 for a linear one."""

    def at(self, share: float) -> float:
        """Return the value at a fraction of the range, 0 to 1."""
        width = self.high - self.low
        if self.scale:
            above = self.scale * math.expm1(share * math.log1p(width / self.scale))
        else:
            above = share * width
        value = min(self.low + above, self.high)
        return round(value) if self.whole else float(f"{value:.6g}")

    def share(self, value: float) -> float:
        """Return the fraction of the range at a value."""
        above, width = value - self.low, self.high - self.low
        if self.scale:
            return math.log1p(above / self.scale) / math.log1p(width / self.scale)
        return above / width


def settings_of(controller: Controller, names: Sequence[str] | None = None) -> list[Setting]:
    """Return the numbers of a controller that have two bounds, or the named ones among them."""
    found = {}
    for name, info in type(controller).model_fields.items():
        ends = {}
        for side, keys in (("low", ("ge", "gt")), ("high", ("le", "lt"))):
            given = (getattr(one, key, None) for one in info.metadata for key in keys)
            ends[side] = next((bound for bound in given if bound is not None), math.inf)
        if info.annotation in (int, float) and all(map(math.isfinite, ends.values())):
            above, width = getattr(controller, name) - ends["low"], ends["high"] - ends["low"]
            scale = above if 0 < above < width / _WIDE else 0.0
            found[name] = Setting(name, **ends, whole=info.annotation is int, scale=scale)
    if not found:
        raise RequestError(
            f"{controller.plugin_name}: this controller has no number between two bounds to tune"
        )
    for name in names or ():
        if name not in found:
            raise RequestError(
                f"--settings: {controller.plugin_name} has no number {name!r} between two bounds"
                f"{close_match(name, found)}; known: {', '.join(found)}"
            )
    return [found[name] for name in dict.fromkeys(names or found)]


@dataclass(frozen=True)
class Spending:
    """How a search spends its budget."""

    candidates: int
    """Of a generation."""
    generations: int
    episodes: int
    """Of a candidate on each scene."""
    final: int
    """The same at the end: for the choice, and once more for the two scores."""

    @classmethod
    def of(cls, budget: int, settings: int, scenes: int, episodes: int | None) -> Spending:
        """Divide the episodes of a budget; ``episodes``: those of a candidate on each scene."""
        each = max(_LEAST, EPISODES // scenes) if episodes is None else episodes
        candidates = 4 + int(3 * math.log(max(2, settings)))  # Hansen 2016, Table 1
        final = max(_FEWEST, int(_FINAL * budget / (_FINALISTS + 2) / scenes))
        ending, generation = (_FINALISTS + 2) * final * scenes, candidates * each * scenes
        if budget < ending + generation:
            least = (_FINALISTS + 2) * _FEWEST * scenes + generation
            raise RequestError(
                f"budget: at least {max(least, math.ceil(generation / (1 - _FINAL)))} episodes are "
                f"needed, for one generation and the comparison at the end; the value is {budget}"
            )
        return cls(candidates, (budget - ending) // generation, each, final)


@dataclass(frozen=True)
class Tuned:
    """The settings that a search found, beside those that it began with."""

    settings: Sequence[Setting]
    start: Fields
    found: Fields
    """Equal to ``start`` if nothing was better beyond chance in the comparison at the end."""
    before: Interval
    after: Interval
    difference: Interval
    p: float
    """Of the difference, two-sided [-]."""
    episodes: int
    """Behind the two scores."""


def search(
    settings: Sequence[Setting],
    start: Fields,
    valid: Callable[[Fields], bool],
    spending: Spending,
    measure: Measure,
    *,
    seed: int,
    earlier: Sequence[Sequence[float]] = (),
    keep: Callable[[list[list[float]]], None] = lambda costs: None,
) -> Tuned:
    """Search from the ``start`` on, among settings that are ``valid`` for the controller.

    ``earlier``: costs of the candidates of the first generations, which an interrupted search gave
    to ``keep``; equal arguments propose equal candidates.
    """
    strategy = _strategy(settings, start, spending, seed)
    costs, bests = list(map(list, earlier)), list[Fields]()

    def values(x: Sequence[float]) -> Fields:
        return {s.name: s.at(float(share)) for s, share in zip(settings, x, strict=False)}

    for number in range(spending.generations):
        sampled = [
            _sample(strategy, lambda x: valid(values(x))) for _ in range(spending.candidates)
        ]
        candidates = list(map(values, sampled))
        if number == len(costs):
            best = f", best {min(costs[-1]):.3f}" if costs else ""
            label = f"generation {number + 1} of {spending.generations}{best}"
            scores = measure(candidates, number, spending.episodes, label)
            costs.append([_cost(score) for score in scores])
            keep(costs)
        strategy.tell(sampled, costs[number])
        bests.append(candidates[int(np.argmin(costs[number]))])
    favourite = values(strategy.result.xfavorite)
    finalists = [start]
    for one in (favourite, *bests[-_RECENT:]):
        if one not in finalists and valid(one):
            finalists.append(one)
    end = spending.generations
    final = measure(finalists, end, spending.final, "choice")
    at = int(np.argmin(list(map(_cost, final))))
    gain, _ = difference_interval(final[at], final[0])
    # The best of several is often so by chance; the start stays unless it is beaten beyond that.
    found = start if gain.high is None or gain.high >= 0 else finalists[at]
    old, new = measure([start, found], end + 1, spending.final, "scores")
    difference, p = difference_interval(new, old)
    ends = mean_interval(old), mean_interval(new)
    return Tuned(settings, start, found, *ends, difference, p, spending.final * len(old))


def _strategy(settings: Sequence[Setting], start: Fields, spending: Spending, seed: int) -> Any:
    """Return a CMA-ES over fractions of the ranges."""
    try:
        import cma
    except ImportError as error:
        raise MissingExtraError("tune needs the package cma; install flipperctl[tune]") from error
    rng = np.random.default_rng(seed)
    first = [setting.share(start[setting.name]) for setting in settings]
    first += [0.5] * (2 - len(first))  # it takes two dimensions at least; the second has no effect
    options = {"bounds": [0, 1], "popsize": spending.candidates, "verbose": -9, "seed": math.nan}
    options["randn"] = lambda *shape: rng.standard_normal(shape)
    return cma.CMAEvolutionStrategy(first, _SPREAD, options)


def _sample(strategy: Any, valid: Callable[[Sequence[float]], bool]) -> Any:
    """Return the first sample that the controller takes."""
    samples = (strategy.ask(1)[0] for _ in range(_TRIES))
    found = next(filter(valid, samples), None)
    if found is None:
        raise RequestError(
            f"none of {_TRIES} samples within the bounds is valid for the controller"
        )
    return found


def _cost(scores: Scores) -> float:
    if not math.isfinite(found := float(means(scores).mean())):
        raise NonFiniteError(f"the score of a candidate is {found}")
    return found


@dataclass
class Playing:
    """Measures candidates by episodes of trainings, which no evaluation plays."""

    entries: Sequence[Entry]
    """The controller on each scene."""
    objective: Objective
    seed: int
    player: Player
    """One of ``training``."""
    tell_size: Callable[[int], None]
    """Called with the number of episodes of each candidate and scene before they are played."""

    def __call__(
        self, candidates: Sequence[Fields], draws: int, episodes: int, label: str
    ) -> list[Scores]:
        """Return the scores of the candidates; see ``Measure``."""
        seed = training_seed(self.seed, draws)
        self.tell_size(episodes)
        requests = [
            (_numbered(entry, episodes, seed), replace(entry.source, settings=settings))
            for fields in candidates
            for entry in self.entries
            for settings in [{**(entry.source.settings or {}), **fields}]
        ]
        played = list(self.player.play_many(requests, label))
        if len(played) < len(requests):
            raise InterruptedRunError("interrupted")
        count = len(self.entries)
        parts = [played[at : at + count] for at in range(0, len(played), count)]
        samples = [SeedSamples("", *self._samples(scenes)) for scenes in parts]
        prices = failure_prices(samples)
        return [one.scores(prices) for one in samples]

    def _samples(self, scenes: Sequence[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return values and whether the finish was reached, by scene; all count for a reward."""
        values, reached = {}, {}
        for at, rows in enumerate(scenes):
            by_reward = self.objective == "reward"
            numbers = rows.values("return" if by_reward else "pitch_variation_100hz")
            values[str(at)] = np.array([numbers]) * (-1 if by_reward else 1)
            reached[str(at)] = np.array(
                [[by_reward or row["outcome"] == "reached" for row in rows]]
            )
        return values, reached


def _numbered(entry: Entry, episodes: int, seed: int) -> Any:
    numbers = entry.config.eval.model_copy(update={"episodes": episodes, "seed": seed})
    return entry.config.model_copy(update={"eval": numbers})


@dataclass(frozen=True)
class Request:
    """What a search is asked for."""

    entries: Sequence[Entry]
    words: Sequence[str]
    """Overrides as typed."""
    objective: Objective
    budget: int
    seed: int
    episodes: int | None
    """Of a candidate on each scene; None for the default."""
    names: Sequence[str] | None = None
    """Settings to search; None for all."""

    @property
    def controller(self) -> Controller:
        """The controller with the settings of the start."""
        return self.entries[0].source.controller()

    def tune(self, player: Player, tell_size: Callable[[int], None], state: Path) -> Tuned:
        """Search; ``state`` keeps the finished generations until the search ends.

        Raises:
            InterruptedRunError: the player was stopped.
            OutputError: ``state`` is of another search.
        """
        controller = self.controller
        settings = settings_of(controller, self.names)
        spending = Spending.of(self.budget, len(settings), len(self.entries), self.episodes)
        start = {one.name: getattr(controller, one.name) for one in settings}
        fixed = resolver.to_dict(controller)
        asked: dict[str, Any] = {"controller": fixed, "start": start, "words": list(self.words)}
        asked |= {"spending": asdict(spending), "version": __version__}
        asked |= {"objective": self.objective, "seed": self.seed}

        def valid(fields: Fields) -> bool:
            try:
                resolver.create("controller", {**fixed, **fields}, "")
            except ConfigError:
                return False
            return True

        def keep(costs: list[list[float]]) -> None:
            write_json(state, {"search": asked, "costs": costs})

        playing = Playing(self.entries, self.objective, self.seed, player, tell_size)
        earlier = _earlier(state, asked)
        found = search(
            *(settings, start, valid, spending, playing),
            seed=self.seed,
            earlier=earlier,
            keep=keep,
        )
        state.unlink(missing_ok=True)
        return found

    def policy_file(self, tuned: Tuned) -> PolicyFile:
        """Return the file of the settings that were found."""
        before, after, difference = (
            Score(**one.to_dict()) for one in (tuned.before, tuned.after, tuned.difference)
        )
        own = resolver.to_dict(self.controller) | tuned.found
        tuning = Tuning(
            words=list(self.words),
            objective=self.objective,
            seed=self.seed,
            budget=self.budget,
            before=before,
            after=after,
            difference=difference,
            version=__version__,
        )
        return PolicyFile(controller=own.pop("name"), settings=own, tuning=tuning)

    def table(self, tuned: Tuned) -> Table:
        """Return the settings before and after, and the scores."""
        model = type(self.controller)
        rows = [
            {
                "setting": f"{one.name} [{unit(model, one.name)}]",
                "before": tuned.start[one.name],
                "after": tuned.found[one.name],
                "bounds": bounds(model, one.name),
            }
            for one in tuned.settings
        ]
        measured = f"pitch variation [rad], a failed episode at least {PRICE:.2f}"
        measured = measured if self.objective == "pitch" else "minus the reward [-]"
        old, new, change = (
            interval_text(one.to_dict(), 3, sign=sign)
            for one, sign in ((tuned.before, ""), (tuned.after, ""), (tuned.difference, "+"))
        )
        scores = f"before {old}, after {new}, difference {change}"
        if tuned.found == tuned.start:
            scores = f"{old}; nothing was better beyond chance, so the settings stay"
        notes = [f"{measured}, over {tuned.episodes} fresh training episodes:", scores]
        return Table(_COLUMNS, rows, notes=notes)


def _earlier(state: Path, asked: Mapping[str, Any]) -> list[list[float]]:
    """Return the costs of the generations that an interrupted search of the same kept."""
    try:
        found = json.loads(state.read_bytes())
        costs = [list(map(float, one)) for one in found["costs"]]
        same = found["search"] == json.loads(json.dumps(asked))
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError, KeyError):
        same = False
    if not same:
        raise OutputError(
            f"{state} is of another search, with other settings or another version; delete it, or "
            "choose another --output"
        )
    return costs
