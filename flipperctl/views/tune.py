"""Settings before and after a search, and their scores, as a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from flipperctl.api import Controller
from flipperctl.evaluation.seeds import PRICE
from flipperctl.evaluation.statistics import Interval
from flipperctl.evaluation.tuning import Request, Tuned
from flipperctl.text.messages import bounds, meaning, unit
from flipperctl.text.show import Column, Table, interval_text

_COLUMNS = (
    Column("setting", "setting", named=True),
    Column("before", "before", 3),
    Column("after", "after", 3),
    Column("bounds", "bounds"),
)


def table(request: Request, tuned: Tuned) -> Table:
    """Return the settings before and after, and the scores."""
    model = type(request.controller)
    # A row for each setting
    rows = [
        {
            "setting": f"{name} [{unit(model, name)}]",
            "before": _shown(tuned.start[name], model, name),
            "after": _shown(value, model, name),
            "bounds": bounds(model, name),
        }
        for name, value in tuned.found.items()
    ]

    # What the scores say of the search
    measured = f"pitch variation [rad], a failed episode {PRICE:.2f}"
    measured = measured if request.objective == "pitch" else "minus the reward [-]"
    old, new, change = (
        interval_text(score.to_dict(), 3, sign=sign)
        for score, sign in ((tuned.before, ""), (tuned.after, ""), (tuned.difference, "+"))
    )
    notes = [f"{measured}, over {tuned.episodes} fresh training episodes:"]
    if tuned.found == tuned.start:
        notes += [f"{old}; nothing was better beyond chance, so the settings stay"]
    else:
        notes += [f"before {old}, after {new}, difference {change}:"]
        notes += [_verdict(tuned.difference)]
    return Table(_COLUMNS, rows, notes=notes)


def _shown(value: Any, model: type[Controller], name: str) -> Any:
    """Return a value for a cell; a list shows its size, an empty one its field's description.

    Such a description has ``; empty: those of the package, learnt on…``.
    """
    if value == []:
        return meaning(model, name).partition("; empty: ")[2].partition(",")[0] or "empty"
    return f"{np.size(value)} numbers" if isinstance(value, list) else value


def _verdict(difference: Interval) -> str:
    """Return how the resulting settings compare with the start."""
    if difference.low is not None and difference.low > 0:
        return "worse than before, beyond chance: keep those before, or give a larger budget"
    if difference.high is not None and difference.high < 0:
        return "better than before, beyond chance"
    return "no difference beyond chance; a larger budget may find one"
