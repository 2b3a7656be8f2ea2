"""Results by what was drawn: length, height, slope, friction (``eval --by``).

In: the episodes of a policy and its baselines, and names of drawn numbers. Out: groups of equal or
similar numbers as plain data, each with its summary and differences, and their tables.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from flipperctl.config import EvalConfig
from flipperctl.config.words import check_different
from flipperctl.env.ground import generate_profile
from flipperctl.errors import RequestError
from flipperctl.evaluation.evaluate import Played
from flipperctl.evaluation.rows import Episodes
from flipperctl.evaluation.views import summary
from flipperctl.messages import close_match
from flipperctl.show import Column, Table

_TRIES = 100  # number of profiles in which a name is looked for before the evaluation
_STARTS = ("start_shift", "start_front", "start_rear")

Names = tuple[str, ...]
"""Numbers whose combinations are groups."""


def parse(text: str | None, option: str, configs: Sequence[EvalConfig]) -> list[Names]:
    """Return the names in ``steps,slope+up``: a list of tables, each by one or several numbers.

    Raises:
        RequestError: a name is empty or repeated, or no scene draws such a number.
    """
    if text is None:
        return []
    found = [tuple(name.strip() for name in part.split("+")) for part in text.split(",")]
    if not all(all(names) and len(set(names)) == len(names) for names in found):
        raise RequestError(f"{option}: names as in steps,slope+up are allowed; got {text!r}")
    check_different(f"{option} {text}", ["+".join(sorted(names)) for names in found])
    for name in dict.fromkeys(name for names in found for name in names):
        known: dict[str, None] = {}
        for config in configs:
            if _draws(config, name, known):
                break
        else:
            raise RequestError(
                f"{option}: no scene draws {name!r}{close_match(name, known)}; "
                f"known: {', '.join(known)}"
            )
    return found


def _draws(config: EvalConfig, name: str, known: dict[str, None]) -> bool:
    """Return whether a scene draws a number of this name; add the names it draws to ``known``."""
    rng = np.random.default_rng(0)
    for attempt in range(_TRIES):
        if attempt == 0:
            known |= dict.fromkeys([*_STARTS, *config.sample(rng)])
        drawn = generate_profile(config.terrain, rng, 1.0).drawn
        known |= dict.fromkeys(drawn)
        if name in known:
            return True
    return False


def groups(
    one: Played, others: Sequence[Played], by: Sequence[Names]
) -> dict[str, list[dict[str, Any]]]:
    """Return the groups of a scene by each combination of numbers, as plain data."""
    return {"+".join(names): list(_groups(one, others, names)) for names in by}


def _groups(one: Played, others: Sequence[Played], names: Names) -> Iterator[dict[str, Any]]:
    terrain = one.entry.terrain
    for ranges, episodes in one.episodes.binned(names):
        own = {
            other.entry.label: Episodes(tuple(row for _, row in episodes.paired(other.episodes)))
            for other in others
        }
        yield {
            "drawn": {name: {"low": low, "high": high} for name, (low, high) in ranges.items()},
            **summary.summary(terrain, episodes),
            **summary.baselines(terrain, episodes, own),
        }


def tables(name: str, scene: Mapping[str, Any]) -> Iterator[Table]:
    """Yield a table for each combination of numbers: success, and differences to the baselines."""
    for by, found in scene.get("by", {}).items():
        if found:
            yield _table(name, scene, by, found)


def _table(
    name: str, scene: Mapping[str, Any], by: str, found: Sequence[Mapping[str, Any]]
) -> Table:
    numbers = list(found[0]["drawn"])
    against = list(
        dict.fromkeys(other["controller"] for group in found for other in summary.compared(group))
    )
    head = [Column(f"drawn_{one}", one) for one in numbers]
    head += [Column("episodes", "episodes"), Column("success_text", "success")]
    head.append(Column("pitch_variation_100hz", summary.VARIATION))
    head += [Column(f"gap_{label}", f"Δ to {label} [rad]", sign="+") for label in against]
    who = scene.get("method") or scene["controller"]
    title = f"{summary.short(who)} on {name} by {by.replace('+', ' and ')}"
    return Table(head, [_row(group) for group in found], title)


def _row(group: Mapping[str, Any]) -> dict[str, Any]:
    ends = {name: (one["low"], one["high"]) for name, one in group["drawn"].items()}
    drawn = {
        f"drawn_{name}": f"{low:.4g}" if low == high else f"{low:.3g} to {high:.3g}"
        for name, (low, high) in ends.items()
    }
    gaps = {
        f"gap_{other['controller']}": other["difference"]["pitch_variation_100hz"]
        for other in summary.compared(group)
    }
    return {**group, **drawn, **gaps, "success_text": summary.rate_text(group["success"])}
