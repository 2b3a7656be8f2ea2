"""The regret of a policy as a table and in sentences.

In: documents of ``evaluation.regret``. Out: a table, sentences, and lines after a training.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.regret import LEVEL, PITCH, Verdict
from flipperctl.evaluation.statistics import FEWEST
from flipperctl.text.messages import percent
from flipperctl.text.show import Column, Table, interval_text
from flipperctl.views.summary import Document, named

_STILL = "holding the flippers still"
_WORDS = {
    Verdict.LESS: f"EARNS LESS THAN {_STILL.upper()}",
    Verdict.MORE: f"earns more than {_STILL}",
    Verdict.UNDECIDED: f"not shown to earn more than {_STILL}",
}

_COLUMNS = (
    Column("scene", "scene", named=True),
    Column("policy", "policy", named=True),
    Column("success", "success"),
    Column("return", "return"),
    Column("above_level", f"return − {LEVEL}"),
    Column("regret", "regret"),
    Column("fraction", "share of the gain"),
)


def table(scenes: Sequence[Document]) -> Table:
    """Return a table with a row for each policy on each scene, the judged one first."""
    rows: list[dict[str, Any]] = []
    called = short_names([label for s in scenes for label in (s["name"], *s["references"])])
    for name, scene in _named(scenes):
        # The judged policy, its references, then the best of each episode
        policies = [(scene["name"], scene["policy"]), *scene["references"].items()]
        for label, numbers in policies:
            success = percent(numbers["success_rate"])
            row = {**numbers, "policy": called[label], "success": success}
            rows.append({**row, "scene": name if numbers is scene["policy"] else ""})
        best = {"return": scene["best_known"]["return"], "policy": "best of each episode"}
        rows.append({"scene": "", "success": "", "above_level": "", "regret": "", **best})
        rows[-len(policies) - 1]["line"] = True
    title = "Rewards over all episodes, without shaping; paired by seed; 95 % intervals"
    return Table(_COLUMNS, rows, title)


def sentences(scenes: Sequence[Document]) -> Iterator[tuple[str, bool]]:
    """Yield sentences that compare the policy with holding still, and whether each is an alarm."""
    called = short_names([label for s in scenes for label in (s["name"], *s["references"])])
    for name, scene in _named(scenes):
        few = f" (fewer than {FEWEST} episodes)" if scene["episodes"] < FEWEST else ""
        above, best = scene["policy"]["above_level"], scene["best_reference"]
        lacks = best["regret"]
        low, high = (None if lacks[end] is None else -lacks[end] for end in ("high", "low"))
        gap = interval_text({"mean": -lacks["mean"], "low": low, "high": high}, sign="+")
        verdict, reference = Verdict(scene["verdict"]), called[best["name"]]
        yield (
            f"{called[scene['name']]} on {name}: {_WORDS[verdict]}{few}, difference "
            f"{interval_text(above, sign='+')}; to the best reference, {reference}: {gap}",
            verdict is Verdict.LESS,
        )
    # Over all scenes, if there are several
    fractions = [f for s in scenes if (f := s["policy"]["fraction"]) is not None]
    if len(scenes) > 1 and fractions:
        mean = sum(fractions) / len(fractions)
        yield f"share of the gain, mean of {len(fractions)}: {mean:.2f}", False
    less = sum(scene["verdict"] == Verdict.LESS for scene in scenes)
    if len(scenes) > 1 and less:
        who = called[scenes[0]["name"]]
        yield f"{who} {_WORDS[Verdict.LESS]} in {less} of {len(scenes)} comparisons", True


def _named(scenes: Sequence[Document]) -> Iterator[tuple[str, Document]]:
    """Yield each scene and its name, with its rewards if they are several."""
    several = len({scene["rewards"] for scene in scenes}) > 1
    for name, scene in named({"scenes": [{**scene, "method": ""} for scene in scenes]}):
        yield f"{name}, rewards {scene['rewards']}" if several else name, scene


def line(measured: Mapping[str, Any] | None) -> str:
    """Return lines on a training's best policy beside the rules, as in its ``summary.json``.

    The first two are on their rewards, the last two on what ``eval`` shows, which may differ in
    sign. Each ends with a line break; the text is empty if nothing was measured.
    """
    if measured is None:
        return ""
    reward, above = measured["policy"]["return"], measured["policy"]["above_level"]
    rules = (
        f"{'flippers held still' if name == LEVEL else name} {reference['return']['mean']:.2f}"
        for name, reference in measured["references"].items()
    )
    rewards = "; ".join([f"return {reward['mean']:.2f}", *rules])
    verdict = Verdict(measured["verdict"])
    be = "is " if verdict is Verdict.UNDECIDED else ""
    return (
        f"Check on {measured['episodes']} new episodes, 95 % intervals in brackets: {rewards}.\n"
        f"The policy {be}{_WORDS[verdict]} ({interval_text(above, sign='+')}).\n"
        f"{_level_line(measured)}"
    )


def falls_short(measured: Mapping[str, Any] | None) -> bool:
    """Return whether a policy crosses less than holding the flippers still, or pitches more."""
    if measured is None or LEVEL not in measured["references"]:
        return False
    policy, level = measured["policy"], measured["references"][LEVEL]
    above = policy["pitch_above_level"] or {}
    return policy["success_rate"] < level["success_rate"] or (above.get("low") or 0.0) > 0


def _level_line(scene: Mapping[str, Any]) -> str:
    """Return a line on success and pitch variation beside holding still, if they were measured."""
    policy, level = scene["policy"], scene["references"].get(LEVEL)
    if level is None:
        return ""
    texts = []
    for words, numbers in ((", pitch variation", policy), (",", level)):
        variation = "" if numbers[PITCH] is None else f"{words} {numbers[PITCH]:.2f} rad"
        texts.append(f"{percent(numbers['success_rate'])}{variation}")
    line = f"On the same episodes: success {texts[0]} (flippers held still: {texts[1]})"
    if (above := policy["pitch_above_level"]) is not None:
        words = f"is not shown to pitch less than {_STILL}"
        if above["low"] is not None and round(above["low"], 2) > 0:  # as it is shown
            words = f"PITCHES MORE THAN {_STILL.upper()}"
        elif above["high"] is not None and round(above["high"], 2) < 0:
            words = f"pitches less than {_STILL}"
        line += f".\nIt {words} ({interval_text(above, sign='+')} rad where both reached)"
    return f"{line}.\n"
