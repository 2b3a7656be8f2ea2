"""Figures of stored results: intervals, heat tables, paired differences, performance profiles.

In: folders of ``eval --output``. Out: rows of plain data for ``flipperctl.figures.methods``, and
the figure of a kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flipperctl.api import Controller, FloatArray, Measure, Outcome, registry
from flipperctl.env.metrics import CORE
from flipperctl.errors import RequestError
from flipperctl.evaluation.names import renamed, taken
from flipperctl.evaluation.rows import telling
from flipperctl.evaluation.seeds import (
    SeedSamples,
    difference_interval,
    mean_interval,
    profile,
    resampled,
    success_interval,
)
from flipperctl.evaluation.stored import named_path, read, read_document
from flipperctl.figures.figure import SUCCESS, VARIATION
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.rollout.trace import Trace
from flipperctl.rollout.trace import read as read_traces
from flipperctl.text.messages import spans, unknown
from flipperctl.views import compare
from flipperctl.views.summary import named

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEVELS = 201  # number of scores at which a profile is drawn [-]
_RESAMPLES = 400  # number of bootstrap samples of a band [-]
_ALWAYS = ("max_pitch", "decisions", "return")
"""Columns whose means are over all episodes, failed ones included."""


@dataclass(frozen=True)
class Request:
    """What to draw, and the folders of its results."""

    folders: Sequence[str]
    """``DIR`` or ``METHOD=DIR``."""
    metrics: Sequence[str] = ()
    """Columns of results; empty: the kind's own."""
    names: Sequence[str] = ()
    """``NAME=METHOD``."""
    only: Sequence[str] = ()
    """Methods to draw; empty: all."""
    against: str | None = None
    """A method, by default ``level``, or the first without it."""
    scene: str | None = None
    """Scene of an episode, by default the first."""
    episode: int | None = None
    """Index of an episode, by default the most telling one; see ``rows.telling``."""
    width: float | None = None
    """[in]; None: the kind's own."""

    def sized(self) -> dict[str, float]:
        """Return the width as an argument of a figure."""
        return {} if self.width is None else {"width": self.width}

    def paths(self) -> Iterator[Path]:
        """Yield the folders."""
        yield from (named_path(folder)[1] for folder in self.folders)

    def scenes(self) -> dict[str, str]:
        """Return the names of scenes in tables, where several are of one terrain.

        The keys are the terrain with the hash of its conditions, as in ``stored``.
        """
        names_of: dict[str, str] = {}
        for path in self.paths():
            try:
                for name, scene in named(read_document(path)):
                    names_of[f"{scene['terrain']} {scene['conditions']['hash']}"] = name
            except (RequestError, LookupError, TypeError):
                continue  # the episodes alone are needed
        return names_of if len(set(names_of.values())) == len(names_of) else {}

    def called(self, labels: Sequence[str]) -> dict[str, str]:
        """Return what the methods that are drawn are called, by label."""
        called = renamed(labels, self.names)
        drawn = [taken(name, called, "--only") for name in self.only] or called
        return {label: called[label] for label in drawn}

    def places(self, labels: Sequence[str]) -> dict[str, int]:
        """Return the index of each method's look by what it is called, left out or not."""
        from flipperctl.figures.figure import places

        called = renamed(labels, self.names)
        return {called[label]: place for label, place in places(labels, rules()).items()}

    def one_metric(self) -> str:
        """Return the metric of a kind that shows one."""
        if len(self.metrics) > 1:
            raise RequestError(f"--metric {','.join(self.metrics)}: this kind shows one metric")
        return self.metrics[0] if self.metrics else VARIATION


def rules() -> list[str]:
    """Return the names of the known rules, ascending."""
    return sorted(name for kind, name in registry if kind == Controller.kind)


def estimates(
    request: Request, metrics: Sequence[str]
) -> tuple[list[dict[str, Any]], tuple[str, ...], dict[str, int]]:
    """Return a row for each method on each scene, what was left out in sentences, and the looks.

    A row has ``method``, ``scene`` and each metric: a mean with its 95 % interval over training
    seeds and episodes, over the episodes that all seeds reached, or None.
    """
    stored = {m: read(request.folders, VARIATION if m == SUCCESS else m) for m in metrics}
    first = next(iter(stored.values()))
    labels, scenes = [method.name for method in first.methods], request.scenes()
    rows = []
    for label, name in request.called(labels).items():
        for scene in first.episodes:
            row: dict[str, Any] = {"method": name, "scene": scenes.get(scene, scene)}
            for metric, results in stored.items():
                row[metric] = _estimate(results.methods[labels.index(label)], scene, metric)
            rows.append(row)
    return rows, first.notices, request.places(labels)


def _estimate(method: SeedSamples, scene: str, metric: str) -> dict[str, Any] | None:
    if metric == SUCCESS:
        return success_interval(method.on(scene)).to_dict()
    values = (method.crossings() if _only_reached(metric) else method.values)[scene]
    return mean_interval({scene: values}).to_dict() if values.size else None


def _only_reached(metric: str) -> bool:
    measure = registry.get((Measure.kind, metric))
    further = measure is not None and issubclass(measure, Measure) and not measure.reached_only
    return metric not in _ALWAYS and (metric in CORE or not further)


def differences(
    comparison: compare.Comparison, called: Mapping[str, str], metric: str, against: str
) -> Iterator[dict[str, Any]]:
    """Yield a row for each method on each scene: its scores minus those of ``against``.

    Scores count failures, as in ``compare``; seeds are averaged within an episode.
    """
    (other,) = (m for m in comparison.stored.methods if m.name == against)
    baseline = other.scores(comparison.price)
    for method in (m for label in called for m in comparison.stored.methods if m.name == label):
        if method is other:
            continue
        for scene, scores in method.scores(comparison.price).items():
            reached, before = (m.reached[scene].all(axis=0) for m in (method, other))
            gap, _ = difference_interval({scene: scores}, {scene: baseline[scene]})
            yield {
                "method": called[method.name],
                "scene": scene,
                metric: gap.to_dict(),
                "episodes": scores.mean(axis=0) - baseline[scene].mean(axis=0),
                "failed": before.astype(int) - reached,
            }


def profiles(
    comparison: compare.Comparison, called: Mapping[str, str]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return levels, (L,), up to the largest score that was reached, and a curve of each method.

    A curve is the share of episodes at or below each level, averaged over scenes, (3, L). Both ends
    of its 95 % band follow, by a bootstrap over seeds and episodes.
    """
    methods = [m for label in called for m in comparison.stored.methods if m.name == label]
    # Levels up to the roughest crossing
    largest = [
        float(m.values[scene][reached].max(initial=0.0))
        for m in methods
        for scene, reached in m.reached.items()
    ]
    levels = np.linspace(0.0, 1.02 * (max(largest) or comparison.price), _LEVELS)
    # A failure is below no level, so that a curve ends at the success rate.
    curves = {}
    for method in methods:
        scores = method.scores(math.inf)
        share = np.mean([1.0 - profile(values, levels) for values in scores.values()], axis=0)
        below = {k: (v[:, :, None] <= levels).astype(np.float64) for k, v in scores.items()}
        drawn = resampled(below, np.random.default_rng(0), _RESAMPLES).mean(axis=(1, 3))
        curves[called[method.name]] = np.array([share, *np.percentile(drawn, [2.5, 97.5], axis=0)])
    return levels, curves


def _intervals(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.methods import intervals_figure

    metrics = list(request.metrics) or [SUCCESS, VARIATION]
    rows, notices, places = estimates(request, metrics)
    return intervals_figure(rows, metrics, places=places, **request.sized()), notices


def _heat(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.methods import heat_figure

    metric = request.one_metric()
    rows, notices, _ = estimates(request, [metric, SUCCESS])
    return heat_figure(rows, metric, **request.sized()), notices


def episodes(
    request: Request,
) -> tuple[list[Trace], list[str], dict[str, int], list[str]]:
    """Return a trace of each method on one episode, the methods' names and looks, and notices.

    A method with several training seeds has the trace of the first one. By default, the episode is
    the most telling one among those with traces of all methods. Notices say which ones it lacks.

    Raises:
        RequestError: there are no traces, or none of this scene, episode or method.
    """
    traces: list[Trace] = []
    for path in request.paths():
        file = path / TRACES
        if not file.is_file():
            raise RequestError(
                f"{file}: there is no such file; the eval --output of this folder writes it, again"
            )
        traces += read_traces(file)
    scene = _one_of("--scene", request.scene, [trace.scene for trace in traces])
    # The traces of each method on this scene by episode, of its first training seed
    by_method: dict[str, dict[int, Trace]] = {}
    for trace in traces:
        if trace.scene == scene:
            method = by_method.setdefault(trace.policy.partition(", seed ")[0], {})
            method.setdefault(trace.episode, trace)
    called = request.called(list(by_method))
    known = [*dict.fromkeys(index for label in called for index in by_method[label])]
    if request.episode is not None:
        wanted = str(request.episode)
        number = int(_one_of("--episode", wanted, [str(index) for index in sorted(known)]))
    else:
        counts = {i: sum(i in by_method[label] for label in called) for i in known}
        number = telling(
            (index, trace.outcome == Outcome.REACHED, float(np.abs(np.diff(trace.pitch)).sum()))
            for label in called
            for index, trace in by_method[label].items()
            if counts[index] == max(counts.values())
        )
    lacking = [label for label in called if number not in by_method[label]]
    notices = [
        f"{scene}, episode {number}: there is no trace of {called[label]}, whose traces are of "
        f"{spans(sorted(by_method[label]))}"
        for label in lacking
    ]
    if lacking and request.only:
        raise RequestError(f"--only: {notices[0]}")
    drawn = [label for label in called if label not in lacking]
    return (
        [by_method[label][number] for label in drawn],
        [called[label] for label in drawn],
        request.places(list(by_method)),
        notices,
    )


def _one_of(option: str, wanted: str | None, known: Sequence[str]) -> str:
    """Return what is wanted, by default the first that is known."""
    wanted = known[0] if wanted is None and known else str(wanted)
    if wanted not in known:
        raise RequestError(unknown(f"{option}: there is no trace of", wanted, dict.fromkeys(known)))
    return wanted


def compared(request: Request) -> tuple[compare.Comparison, dict[str, str], dict[str, int]]:
    """Return the comparison of all methods, what those to be drawn are called, and their looks."""
    comparison = compare.compare(request.folders, measure=request.one_metric())
    labels = [method.name for method in comparison.stored.methods]
    return comparison, request.called(labels), request.places(labels)


def _differences(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.methods import differences_figure

    comparison, called, places = compared(request)
    if len(called) < 2:
        raise RequestError(f"{request.folders[0]}: two methods are needed for differences")
    named = taken(request.against, called, "--against") if request.against else None
    against = named or compare.usual(called)
    rows, scenes = (
        list(differences(comparison, called, comparison.measure, against)),
        request.scenes(),
    )
    rows = [row | {"scene": scenes.get(row["scene"], row["scene"])} for row in rows]
    measure, price = comparison.measure, comparison.price
    drawn = differences_figure(
        rows, measure, called[against], price, places=places, **request.sized()
    )
    return drawn, comparison.stored.notices


def _profiles(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.methods import profiles_figure

    comparison, called, places = compared(request)
    levels, curves = profiles(comparison, called)
    drawn = profiles_figure(levels, curves, comparison.measure, places=places, **request.sized())
    return drawn, comparison.stored.notices


def _series(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.episode import series_figure

    traces, names, places, notices = episodes(request)
    return series_figure(traces, names, places=places, **request.sized()), notices


def _poses(request: Request) -> tuple[Figure, Sequence[str]]:
    from flipperctl.figures.episode import poses_figure

    traces, names, _, notices = episodes(request)
    return poses_figure(traces, names, **request.sized()), notices


KINDS: dict[str, Callable[[Request], tuple[Figure, Sequence[str]]]] = {
    "intervals": _intervals,
    "heat": _heat,
    "differences": _differences,
    "profiles": _profiles,
    "series": _series,
    "poses": _poses,
}
"""Each returns the figure, and what was left out, in sentences."""
