"""Tune a controller's settings on episodes of trainings, by CMA-ES (Hansen 2016) or its ``learn``.

In: scenes with a controller, an objective, a budget of episodes. Out: settings, and their score
beside the score of the start, on episodes that neither search nor choice met. All candidates of a
generation play equal episodes, and each generation has its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl import __version__
from flipperctl.api import Controller
from flipperctl.api.controllers import learns
from flipperctl.config import resolver
from flipperctl.config.policy_file import PolicyFile, Score, Tuning
from flipperctl.errors import (
    ConfigError,
    NonFiniteError,
    OutputError,
    RequestError,
    missing_extra,
)
from flipperctl.evaluation.learning import Demonstrator, Objective, PlayedEpisodes, Playing
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Player, Progress
from flipperctl.evaluation.seeds import (
    Scores,
    difference_interval,
    mean_interval,
    means,
)
from flipperctl.evaluation.statistics import Interval
from flipperctl.plugging.guard import refusal, short_repr
from flipperctl.rollout.episode import training_seed
from flipperctl.text.files import write_json
from flipperctl.text.messages import unknown

BUDGET, EPISODES = 5000, 20
"""Defaults: episodes of a search; of a candidate in a generation, on all scenes together."""
_LEAST, _FEWEST = 4, 5  # episodes of a candidate on a scene: in a generation, and at the end
_RECENT = 3  # generations whose best candidate is compared at the end
_FINALISTS = _RECENT + 2
_FINAL = 0.25  # share of the budget that the comparisons at the end take
_SPREAD = 0.2  # standard deviation of the first generation, as a fraction of each setting's range
_WIDE = 20  # range from which on a setting is searched on a logarithmic scale, in starts [-]
_TRIES = 1000  # samples after which a controller's own rules leave no valid candidate
Fields = dict[str, float]
Measure = Callable[[Sequence[Mapping[str, Any]], int, int, str], list[Scores]]
"""Plays candidates on the draws of a number, so many episodes on each scene, under a label; returns
the score of each candidate's episodes by scene, (1, E); less is better."""


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
    settings = {}
    # Numbers between two bounds; a range that is wide for its start is searched on a logarithmic
    # scale.
    for name, info in type(controller).model_fields.items():
        ends = {}
        for side, keys in (("low", ("ge", "gt")), ("high", ("le", "lt"))):
            limits = (
                getattr(constraint, key, None) for constraint in info.metadata for key in keys
            )
            ends[side] = next((bound for bound in limits if bound is not None), math.inf)
        if info.annotation in (int, float) and all(map(math.isfinite, ends.values())):
            above, width = getattr(controller, name) - ends["low"], ends["high"] - ends["low"]
            scale = above if 0 < above < width / _WIDE else 0.0
            settings[name] = Setting(name, **ends, whole=info.annotation is int, scale=scale)
    if not settings:
        raise RequestError(
            f"{controller.plugin_name}: this controller has no number between two bounds to tune"
        )
    for name in names or ():
        if name not in settings:
            what = f"--settings: {controller.plugin_name} has no number between two bounds called"
            raise RequestError(unknown(what, name, settings))
    return [settings[name] for name in dict.fromkeys(names or settings)]


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
        """Divide the episodes of a budget; ``episodes``: a candidate's on each scene."""
        each = max(_LEAST, EPISODES // scenes) if episodes is None else episodes
        candidates = 4 + int(3 * math.log(max(2, settings)))  # Hansen 2016, Table 1
        # The comparison at the end takes its share, generations take the rest.
        final = max(_FEWEST, int(_FINAL * budget / (_FINALISTS + 2) / scenes))
        ending, generation = (_FINALISTS + 2) * final * scenes, candidates * each * scenes
        if budget < ending + generation:
            least = (_FINALISTS + 2) * _FEWEST * scenes + generation
            raise RequestError(
                f"budget: at least {max(least, math.ceil(generation / (1 - _FINAL)))} episodes are "
                f"needed, for one generation and the comparison at the end; the value is {budget}"
            )
        return cls(candidates, (budget - ending) // generation, each, final)


def learning(budget: int, scenes: int, episodes: int | None) -> tuple[int, int]:
    """Divide a budget: episodes from which a controller learns; on each scene for each score.

    ``episodes``: the latter, if they are given.
    """
    final = episodes or max(_FEWEST, int(_FINAL * budget / 2 / scenes))
    if (count := budget - 2 * final * scenes) < scenes:
        least = (2 * (episodes or _FEWEST) + 1) * scenes
        raise RequestError(
            f"budget: at least {least} episodes are needed, to learn from and "
            f"for the comparison at the end; the value is {budget}"
        )
    return count, final


@dataclass(frozen=True)
class Tuned:
    """The settings that a search found or a controller learnt, and the settings of the start."""

    start: Mapping[str, Any]
    found: Mapping[str, Any]
    """Equal to ``start`` if a search found nothing that is better beyond chance at its end."""
    before: Interval
    after: Interval
    difference: Interval
    p: float
    """Of the difference, two-sided [-]."""
    episodes: int
    """Behind the two scores."""

    @classmethod
    def of(
        cls,
        start: Mapping[str, Any],
        end: Mapping[str, Any],
        measure: Measure,
        draws: int,
        episodes: int,
    ) -> Tuned:
        """Score both on equal episodes, so many on each scene."""
        old, new = measure([start, end], draws, episodes, "scores")
        difference, p = difference_interval(new, old)
        ends = mean_interval(old), mean_interval(new)
        return cls(start, end, *ends, difference, p, episodes * len(old))


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

    # Costs that an interrupted search measured are taken over; the strategy learns from all.
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
    # The favourite and the best of the last generations meet the start on fresh episodes.
    favourite = values(strategy.result.xfavorite)
    finalists = [start]
    for candidate in (favourite, *bests[-_RECENT:]):
        if candidate not in finalists and valid(candidate):
            finalists.append(candidate)
    end = spending.generations
    final = measure(finalists, end, spending.final, "choice")
    at = int(np.argmin(list(map(_cost, final))))
    gain, _ = difference_interval(final[at], final[0])
    # The best of several is often so by chance; the start stays unless it is beaten beyond that.
    winner = start if gain.high is None or gain.high >= 0 else finalists[at]
    return Tuned.of(start, winner, measure, end + 1, spending.final)


def _strategy(settings: Sequence[Setting], start: Fields, spending: Spending, seed: int) -> Any:
    """Return a CMA-ES over fractions of the ranges."""
    try:
        import cma
    except ImportError as error:
        raise missing_extra("tune", "cma") from error
    rng = np.random.default_rng(seed)
    first = [setting.share(start[setting.name]) for setting in settings]
    first += [0.5] * (2 - len(first))  # it takes two dimensions at least; the second has no effect
    options = {"bounds": [0, 1], "popsize": spending.candidates, "verbose": -9, "seed": math.nan}
    options["randn"] = lambda *shape: rng.standard_normal(shape)
    return cma.CMAEvolutionStrategy(first, _SPREAD, options)


def _sample(strategy: Any, valid: Callable[[Sequence[float]], bool]) -> Any:
    """Return the first sample that the controller takes."""
    samples = (strategy.ask(1)[0] for _ in range(_TRIES))
    sample = next(filter(valid, samples), None)
    if sample is None:
        raise RequestError(
            f"none of {_TRIES} samples within the bounds is valid for the controller"
        )
    return sample


def _cost(scores: Scores) -> float:
    if not math.isfinite(score := float(means(scores).mean())):
        raise NonFiniteError(f"the score of a candidate is {score}")
    return score


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
    """Settings to search; None for all, or for those that the controller learns."""
    demonstrator: str | None = None
    """Word of ``from=``."""

    @property
    def controller(self) -> Controller:
        """The controller with the settings of the start."""
        return self.entries[0].source.controller()

    @property
    def learns(self) -> bool:
        """Whether the controller learns its settings; otherwise they are searched."""
        return self.names is None and learns(self.controller)

    def check(self) -> None:
        """Check that demonstrations are named where they are needed, and there alone."""
        name, imitates = self.controller.plugin_name, self.learns and self.controller.imitates
        if imitates and self.demonstrator is None:
            raise RequestError(
                f"tune: {name} learns from demonstrations; add from=POLICY or a folder of drives, "
                "as in from=generalist"
            )
        if not imitates and self.demonstrator is not None:
            raise RequestError(
                f"from={self.demonstrator}: {name} takes no demonstrations here; leave it out"
            )

    def learn(
        self,
        player: Player,
        tell_size: Callable[[int], None],
        progress: Progress,
        stop: Callable[[], bool],
    ) -> Tuned:
        """Let the controller learn, and compare what it learnt with the start on fresh episodes.

        Raises:
            InterruptedRunError: ``stop`` returned True, or the player was stopped.
        """
        controller, seed = self.controller, training_seed(self.seed, 0)
        # The budget is for learning and for the comparison at the end.
        count, final = learning(self.budget, len(self.entries), self.episodes)
        word = self.demonstrator
        shown = None if word is None else Demonstrator(word, self.entries)
        with progress("learning", count) as report:
            episodes = PlayedEpisodes(
                self.entries, self.objective, seed, count, shown, stop, report
            )
            learnt: object = controller.learn(episodes)
        if type(learnt) is not type(controller):
            raise refusal(
                controller, "learn", f"returned {short_repr(learnt)}; its own class is allowed"
            )
        # Only settings that have changed are shown.
        start, end = resolver.to_dict(controller), resolver.to_dict(learnt)
        changed = [name for name in start if start[name] != end[name]]
        playing = Playing(self.entries, self.objective, self.seed, player, tell_size)
        before, after = ({name: values[name] for name in changed} for values in (start, end))
        return Tuned.of(before, after, playing, 1, final)

    def tune(self, player: Player, tell_size: Callable[[int], None], state: Path) -> Tuned:
        """Search; ``state`` keeps the finished generations until the search ends.

        Raises:
            InterruptedRunError: the player was stopped.
            OutputError: ``state`` is of another search.
        """
        controller = self.controller
        settings = settings_of(controller, self.names)
        spending = Spending.of(self.budget, len(settings), len(self.entries), self.episodes)
        start = {setting.name: getattr(controller, setting.name) for setting in settings}
        fixed = resolver.to_dict(controller)
        # Generations of an earlier search count only if all of this is equal.
        identity: dict[str, Any] = {"controller": fixed, "start": start, "words": list(self.words)}
        identity |= {"spending": asdict(spending), "version": __version__}
        identity |= {"objective": self.objective, "seed": self.seed}

        def valid(fields: Fields) -> bool:
            try:
                resolver.create("controller", {**fixed, **fields}, "")
            except ConfigError:
                return False
            return True

        def keep(costs: list[list[float]]) -> None:
            write_json(state, {"search": identity, "costs": costs})

        playing = Playing(self.entries, self.objective, self.seed, player, tell_size)
        earlier = _earlier(state, identity)
        tuned = search(
            settings,
            start,
            valid,
            spending,
            playing,
            seed=self.seed,
            earlier=earlier,
            keep=keep,
        )
        state.unlink(missing_ok=True)
        return tuned

    def policy_file(self, tuned: Tuned) -> PolicyFile:
        """Return the file of the settings that were found."""
        before, after, difference = (
            Score(**score.to_dict()) for score in (tuned.before, tuned.after, tuned.difference)
        )
        fields = resolver.to_dict(self.controller) | dict(tuned.found)
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
        return PolicyFile(controller=fields.pop("name"), settings=fields, tuning=tuning)


def _earlier(state: Path, identity: Mapping[str, Any]) -> list[list[float]]:
    """Return the costs of the generations that an interrupted search of the same kept."""
    try:
        state_before = json.loads(state.read_bytes())
        costs = [list(map(float, cost)) for cost in state_before["costs"]]
        same = state_before["search"] == json.loads(json.dumps(identity))
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
