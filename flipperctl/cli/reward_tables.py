"""The tables and verdicts of ``inspect reward --compare``.

In: a ranking for each scene. Out: a table with a row per policy, and lines of text.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from rich.markup import escape
from rich.table import Table

from flipperctl.cli.swing import HEADING, PAPERS_HEADING
from flipperctl.evaluation.ranking import (
    FEWEST_DRAWS,
    Contradiction,
    SceneRanking,
    Verdict,
)
from flipperctl.evaluation.results import Interval


def table(scenes: Sequence[SceneRanking]) -> Table:
    """Return a table with a row for each policy on each scene, smallest θ̂_R first."""
    title = "means over the draws that every policy crossed; returns without shaping"
    found = Table(title=title, title_justify="left")
    labels = list(dict.fromkeys(ranking.rewards for s in scenes for ranking in s.rankings))
    headings = ("terrain", "draws", "policy", "success", HEADING, PAPERS_HEADING, "t_cost [s]")
    for heading in (*headings, *(f"return, {label}" for label in labels)):
        found.add_column(escape(heading))
    for name, scene in _named(scenes):
        returns = {ranking.rewards: ranking.returns for ranking in scene.rankings}
        for at, (label, policy) in enumerate(scene.policies.items()):
            first = at == 0
            found.add_row(
                name if first else "",
                f"{scene.common} of {scene.episodes}" if first else "",
                escape(label),
                f"{policy.success_rate:.1%}",
                _mean(policy.pitch_variation_100hz, 2),
                _mean(policy.pitch_variation, 2),
                _mean(policy.t_cost, 1),
                *(_mean(returns[name][label], 2) if name in returns else "" for name in labels),
                end_section=at == len(scene.policies) - 1,
            )
    return found


def verdict_lines(scenes: Sequence[SceneRanking]) -> Iterator[str]:
    """Yield a line for each contradiction, and then the verdict on each set of reward terms."""
    verdicts: dict[str, dict[Verdict, list[str]]] = {}
    for name, scene in _named(scenes):
        for ranking in scene.rankings:
            verdicts.setdefault(ranking.rewards, {}).setdefault(ranking.verdict, []).append(name)
            for found in ranking.contradictions:
                yield f"{ranking.rewards} on {name}: {_describe(found)}"
    for label, scenes_by_verdict in verdicts.items():
        words = {
            Verdict.CONTRADICTS: "CONTRADICTS θ̂_R on",
            Verdict.AGREES: "agrees with θ̂_R on",
            Verdict.UNDECIDED: f"undecided (fewer than {FEWEST_DRAWS} common draws) on",
        }
        parts = [
            f"{words[v]} {', '.join(named)}" for v in words if (named := scenes_by_verdict.get(v))
        ]
        yield f"{label}: {'; '.join(parts)}"


def _named(scenes: Sequence[SceneRanking]) -> Iterator[tuple[str, SceneRanking]]:
    """Yield each scene and its terrain, with the conditions' hash if the terrain has several."""
    counts = Counter(scene.terrain for scene in scenes)
    for scene in scenes:
        alone = counts[scene.terrain] == 1
        yield scene.terrain if alone else f"{scene.terrain} {scene.conditions.hash}", scene


def _describe(found: Contradiction) -> str:
    term, part = next(iter(found.terms.items()))
    return (
        f"{found.paid} is paid {_interval(found.return_difference)} more than {found.calm}, but "
        f"its θ̂_R is {_interval(found.pitch_variation_100hz_difference)} rad larger; "
        f"the term {term} pays it {part:+.2f}"
    )


def _interval(found: Interval) -> str:
    return f"{found.mean:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _mean(found: Interval | None, digits: int) -> str:
    return "–" if found is None else f"{found.mean:.{digits}f}"
