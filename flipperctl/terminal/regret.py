"""The table and sentences of ``inspect reward --regret``, and the line at the end of a training.

In: the regret on each scene. Out: a table with a row for each policy, and lines of text.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.text import Text

from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.estimates import Interval
from flipperctl.evaluation.intervals import FEWEST
from flipperctl.evaluation.tables import interval_text
from flipperctl.studies.regret import LEVEL, SceneRegret, Verdict
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.tables import Table

_STILL = "holding the flippers still"
_WORDS = {
    Verdict.LESS: f"EARNS LESS THAN {_STILL.upper()}",
    Verdict.MORE: f"earns more than {_STILL}",
    Verdict.UNDECIDED: f"not shown to earn more than {_STILL}",
}
_ALARM = "bold red"


def print_regret(found: Sequence[SceneRegret]) -> None:
    """Print the returns on each scene, the conditions, and what they say about the policy."""
    out = console()
    table(found).print(out)
    print_lines(out, condition_lines((s.terrain, s.seed, s.conditions) for s in found))
    for text, verdict in sentences(found):
        style = _ALARM if verdict is Verdict.LESS else None
        out.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def table(scenes: Sequence[SceneRegret]) -> Table:
    """Return a table with a row for each policy on each scene, the judged one first."""
    title = "returns without shaping, over all episodes; differences are paired by seed"
    headings = ("terrain", "rewards", "policy", "success", "return", f"return - {LEVEL}")
    found = Table([*headings, "regret", "fraction of the gain"], title)
    for name, scene in _named(scenes):
        for label, one in ((scene.name, scene.policy), *scene.references.items()):
            judged = one is scene.policy
            style = _ALARM if judged and scene.verdict is Verdict.LESS else "bold"
            found.add(
                name,
                scene.rewards,
                Text(label, style) if judged else label,
                f"{one.success_rate:.1%}",
                *map(interval_text, (one.mean, one.above_level, one.regret)),
                fraction_text(one.fraction),
            )
        best = interval_text(scene.best_known)
        found.add(name, scene.rewards, "best known of each episode", "", best, "", "", "")
        found.end_section()
    return found


def sentences(scenes: Sequence[SceneRegret]) -> Iterator[tuple[str, Verdict]]:
    """Yield sentences on the policy and how each compares it with holding the flippers still."""
    for name, scene in _named(scenes):
        place = f"{scene.name} on {name}, rewards {scene.rewards}"
        yield f"{place}: {_comparison(scene)}", scene.verdict
    fractions = [s.policy.fraction for s in scenes if s.policy.fraction is not None]
    if len(scenes) > 1 and fractions:
        mean = fraction_text(sum(fractions) / len(fractions))
        yield f"fraction of the gain, mean of {len(fractions)}: {mean}", Verdict.UNDECIDED
    less = sum(scene.verdict is Verdict.LESS for scene in scenes)
    if len(scenes) > 1 and less:
        text = f"{scenes[0].name} {_WORDS[Verdict.LESS]} in {less} of {len(scenes)} comparisons"
        yield text, Verdict.LESS


def regret_line(found: Mapping[str, Any] | None) -> str:
    """Return lines on a training's best policy beside the rules, as in its ``summary.json``.

    The first is on their returns, the second on what ``eval`` shows, which may differ in sign. Each
    ends with a line break; the text is empty if nothing was measured.
    """
    if found is None:
        return ""
    own, above = (Interval(**found["policy"][name]) for name in ("return", "above_level"))
    rules = (f"{name} {one['return']['mean']:.2f}" for name, one in found["references"].items())
    returns = ", ".join([f"return {interval_text(own)}", *rules])
    words = f"{_WORDS[Verdict(found['verdict'])]}, difference {interval_text(above, sign='+')}"
    line = f"On its own reward, {found['episodes']} episodes: {returns}: {words}.\n"
    return line + _level_line(found)


def _level_line(found: Mapping[str, Any]) -> str:
    """Return a line on success and θ̂_R beside holding still; empty if they were not measured."""
    own, level = found["policy"], found["references"].get(LEVEL)
    if level is None or "pitch_above_level" not in own:
        return ""  # of an earlier version
    told = []
    for name, one in (("the policy", own), (LEVEL, level)):
        pitch = one["pitch_variation_100hz"]
        theta = "" if pitch is None else f", θ̂_R {pitch:.2f} rad"
        told.append(f"{name} success {one['success_rate']:.0%}{theta}")
    line = f"On the same episodes: {'; '.join(told)}"
    if own["pitch_above_level"] is not None:
        line += f"; {_pitch_text(Interval(**own['pitch_above_level']))}"
    return f"{line}.\n"


def _pitch_text(above: Interval) -> str:
    words = f"not shown to pitch less than {_STILL}"
    if above.low is not None and round(above.low, 2) > 0:  # as it is shown
        words = f"PITCHES MORE THAN {_STILL.upper()}"
    elif above.high is not None and round(above.high, 2) < 0:
        words = f"pitches less than {_STILL}"
    return f"{words}, difference {interval_text(above, sign='+')} rad where both reached the finish"


def fraction_text(found: float | None) -> str:
    """Return a fraction with two decimals; ``–`` stands for None."""
    return "–" if found is None else f"{found:z.2f}"


def _comparison(scene: SceneRegret) -> str:
    few = f" (fewer than {FEWEST} episodes)" if scene.episodes < FEWEST else ""
    above, best = scene.policy.above_level, scene.best_reference
    return (
        f"{_WORDS[scene.verdict]}{few}, difference {interval_text(above, sign='+')}; to the best "
        f"reference, {best.name}: {interval_text(_negative(best.regret), sign='+')}"
    )


def _negative(found: Interval) -> Interval:
    if found.low is None or found.high is None:
        return Interval(-found.mean, None, None)
    return Interval(-found.mean, -found.high, -found.low)


def _named(scenes: Sequence[SceneRegret]) -> Iterator[tuple[str, SceneRegret]]:
    """Yield each scene and its name; scenes that differ in rewards alone share a name."""
    first = {(scene.terrain, scene.conditions.label): scene.conditions for scene in scenes}
    names = scene_names([(terrain, found) for (terrain, _), found in first.items()])
    known = dict(zip(first, names, strict=True))
    for scene in scenes:
        yield known[scene.terrain, scene.conditions.label], scene
