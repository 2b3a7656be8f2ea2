"""The output of ``flipperctl eval``: its tables, and notes where something is unusual."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flipperctl.evaluation.evaluate import Result
from flipperctl.evaluation.views import engines, evaluation, published, risk
from flipperctl.evaluation.views.summary import Document, named, short
from flipperctl.show import print_table
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.streams import print_note


def print_result(result: Result, document: Document, columns: Sequence[str] = ()) -> None:
    """Print the tables of a document, with further ``columns``, and the notes of its result."""
    told: set[str] = set()  # once for all methods
    for one in result.rows:
        entry = one.entry
        if one.identical and not (entry.method and entry.conditions.hash in told):
            told.add(entry.conditions.hash)
            print_note(
                f"{entry.terrain}: all {len(one.episodes)} episodes are identical, since nothing "
                "is random; their intervals are meaningless (episode.start_noise, "
                "perception.noise, randomise or conditions=varied make episodes differ)"
            )
    out = console()
    tables = list(evaluation.tables(document, result.plan.title, columns))
    if beside := published.table(document):
        tables.append(beside)
    for at, table in enumerate(tables):
        if at:
            out.print()
        print_table(table, out)
    failures = engines.failure_lines(document.get("engines", ()))
    more = () if columns else ("95 % intervals. More columns: --columns all",)
    print_lines(out, (*failures, *_conditions(result), *_risks(document), *more))


def _conditions(result: Result) -> Iterator[str]:
    """Yield a line for each set of conditions with a setting that is not the default."""
    found: dict[str, dict[str, None]] = {}
    for one in result.rows:
        entry = one.entry
        if words := entry.conditions.line():
            text = f"conditions {entry.conditions.name}: {words}"
            found.setdefault(text, {})[entry.terrain] = None
    for text, terrains in found.items():
        yield text if len(found) == 1 else f"{', '.join(terrains)}: {text}"


def _risks(document: Document) -> Iterator[str]:
    """Yield a line for each policy that told its risk, if it failed or warned."""
    scenes = named(document)
    for name, scene in scenes:
        found = scene.get("risk")
        if found is not None and (found["failures"] or found["false_alarms"]):
            who = short(scene.get("method") or scene["controller"])
            yield f"risk, {who} on {name}: {risk.text(found)}"
