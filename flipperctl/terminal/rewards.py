"""The table and verdicts of ``inspect reward --compare``.

In: a ranking for each scene. Out: a table with a row per policy, and lines of text.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.intervals import FEWEST
from flipperctl.evaluation.tables import interval_text
from flipperctl.studies.ranking import Contradiction, SceneRanking, Verdict
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.pitch_variation import HEADING, PAPERS_HEADING
from flipperctl.terminal.tables import Table


def print_comparison(found: list[SceneRanking]) -> None:
    """Print the ranking of each scene, its conditions, and the verdicts."""
    out = console()
    table(found).print(out)
    conditions = condition_lines((s.terrain, s.seed, s.conditions) for s in found)
    print_lines(out, (*conditions, *verdict_lines(found)))


def table(scenes: Sequence[SceneRanking]) -> Table:
    """Return a table with a row for each policy on each scene, smallest θ̂_R first."""
    title = "means over the episodes that every policy crossed; returns without shaping"
    labels = list(dict.fromkeys(ranking.rewards for s in scenes for ranking in s.rankings))
    headings = ("terrain", "episodes", "policy", "success", HEADING, PAPERS_HEADING, "t_cost [s]")
    found = Table([*headings, *(f"return, {label}" for label in labels)], title)
    for name, scene in _named(scenes):
        returns = {ranking.rewards: ranking.returns for ranking in scene.rankings}
        for label, policy in scene.policies.items():
            found.add(
                name,
                f"{scene.common} of {scene.episodes}",
                label,
                f"{policy.success_rate:.1%}",
                _mean(policy.pitch_variation_100hz, 2),
                _mean(policy.pitch_variation, 2),
                _mean(policy.t_cost, 1),
                *(_mean(returns[one][label], 2) if one in returns else "" for one in labels),
            )
        found.end_section()
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
            Verdict.AGREES: "no contradiction to θ̂_R on",
            Verdict.UNDECIDED: f"undecided (fewer than {FEWEST} common episodes) on",
        }
        parts = [
            f"{words[v]} {', '.join(named)}" for v in words if (named := scenes_by_verdict.get(v))
        ]
        yield f"{label}: {'; '.join(parts)}"


def _named(scenes: Sequence[SceneRanking]) -> Iterator[tuple[str, SceneRanking]]:
    """Yield each scene and its name."""
    names = scene_names([(scene.terrain, scene.conditions) for scene in scenes])
    return zip(names, scenes, strict=True)


def _describe(found: Contradiction) -> str:
    term, part = next(iter(found.terms.items()))
    gain = interval_text(found.return_difference)
    variation = interval_text(found.pitch_variation_100hz_difference)
    return (
        f"the return of {found.paid} is {gain} larger than that of {found.calm}, but its θ̂_R is "
        f"{variation} rad larger (p {found.p_holm:.2g}); the term {term} contributes {part:+.2f}"
    )


def _mean(found: Interval | None, digits: int) -> str:
    return "–" if found is None else f"{found.mean:.{digits}f}"
