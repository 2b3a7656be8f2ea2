"""The table of ``flipperctl inspect reward``: the reward of each term."""

from __future__ import annotations

from flipperctl.studies.audit import AuditResult
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.tables import Table


def print_audit(found: AuditResult) -> None:
    """Print a row for each reward term, and the conditions."""
    title = (
        f"{found.controller} on {found.terrain}: {found.episodes} episodes, "
        f"{found.decisions} decisions, mean return {found.mean_return:.2f}"
    )
    headings = ("term", "weight", "mean a decision", "lowest", "highest", "share of the return")
    table = Table([*headings, "saturated"], title)
    for name, term in found.terms.items():
        table.add(
            name,
            f"{term.weight:g}",
            *(f"{value:.4f}" for value in (term.mean, term.lowest, term.highest)),
            f"{term.share:.1%}",
            "–" if term.saturated is None else f"{term.saturated:.1%}",
        )
    out = console()
    table.print(out)
    print_lines(out, condition_lines([(found.terrain, found.seed, found.conditions)]))
