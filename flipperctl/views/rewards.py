"""The judgement of a reward as tables and sentences.

In: documents of ``evaluation.rewards``. Out: a table of reward terms or of policies, and verdicts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.rewards import MEASURES, Verdict
from flipperctl.evaluation.statistics import FEWEST
from flipperctl.text.messages import percent
from flipperctl.text.show import Column, Table, interval_text
from flipperctl.views.summary import VARIATION, Document, named

_TERMS = (
    Column("term", "term", named=True),
    Column("weight", "weight"),
    Column("mean", "mean of a decision", 4),
    Column("lowest", "lowest", 3),
    Column("highest", "highest", 3),
    Column("share_text", "share of the return"),
    Column("saturated_text", "saturated"),
)


def audit_table(audited: Document, notes: Sequence[str]) -> Table:
    """Return a row for each term, with lines below the table."""
    rows = [
        {
            "term": name,
            **term,
            "share_text": percent(term["share"]),
            "saturated_text": "–" if term["saturated"] is None else percent(term["saturated"]),
        }
        for name, term in audited["terms"].items()
    ]
    (name,) = short_names([audited["controller"]]).values()
    title = (
        f"{name} on {audited['terrain']} · {audited['episodes']} episodes, "
        f"{audited['decisions']} decisions · mean return {audited['return']:.2f}"
    )
    return Table(_TERMS, rows, title, list(notes))


def table(scenes: Sequence[Document]) -> Table:
    """Return a table with a row for each policy on each scene, smallest θ̂_R first."""
    labels = dict.fromkeys(ranking["rewards"] for s in scenes for ranking in s["rankings"])
    rows: list[dict[str, Any]] = []
    called = short_names([label for scene in scenes for label in scene["policies"]])
    for name, scene in named({"scenes": scenes}):
        paid = {f"return_{ranking['rewards']}": ranking["returns"] for ranking in scene["rankings"]}
        for at, (label, policy) in enumerate(scene["policies"].items()):
            # Measures beside what each reward pays for the same episodes
            numbers = {key: policy[key] for key in MEASURES}
            numbers |= {key: returns[label] for key, returns in paid.items()}
            rows.append(
                {
                    "scene": f"{name} ({scene['common']} of {scene['episodes']})" if not at else "",
                    "line": not at,
                    "policy": called[label],
                    "success": percent(policy["success_rate"]),
                    **{key: interval and interval["mean"] for key, interval in numbers.items()},
                }
            )
    columns = (
        Column("scene", "scene (crossed by all)", named=True),
        Column("policy", "policy", named=True),
        Column("success", "success"),
        Column("pitch_variation_100hz", VARIATION),
        Column("t_cost", "time [s]", 1),
        *(Column(f"return_{label}", f"reward, {label}") for label in labels),
    )
    return Table(columns, rows, "Means over the episodes that every policy crossed")


def verdict_lines(scenes: Sequence[Document]) -> Iterator[str]:
    """Yield a line for each contradiction, and then the verdict on each set of reward terms."""
    words = {
        Verdict.CONTRADICTS: "CONTRADICTS pitch variation on",
        Verdict.AGREES: "no contradiction to pitch variation on",
        Verdict.UNDECIDED: f"undecided (fewer than {FEWEST} common episodes) on",
    }
    called = short_names([label for scene in scenes for label in scene["policies"]])
    # Contradictions one by one, then a verdict on each set of terms
    verdicts: dict[str, dict[str, list[str]]] = {}
    for name, scene in named({"scenes": scenes}):
        for ranking in scene["rankings"]:
            known = verdicts.setdefault(ranking["rewards"], {})
            known.setdefault(ranking["verdict"], []).append(name)
            for rival in ranking["contradictions"]:
                term, part = next(iter(rival["terms"].items()))
                gain = interval_text(rival["return_difference"])
                paid, calm = called[rival["paid"]], called[rival["calm"]]
                variation = interval_text(rival["pitch_variation_100hz_difference"])
                yield (
                    f"{ranking['rewards']} on {name}: the reward of {paid} is {gain} "
                    f"larger than that of {calm}, but its pitch variation is {variation} "
                    f"rad larger (p {rival['p_holm']:.2g}, Holm of {rival['holm_of']}); "
                    f"the term {term} contributes {part:+.2f}"
                )
    for label, by_verdict in verdicts.items():
        parts = [f"{words[v]} {', '.join(on)}" for v in words if (on := by_verdict.get(v))]
        yield f"{label}: {'; '.join(parts)}"
