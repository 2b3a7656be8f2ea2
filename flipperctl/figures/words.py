"""Axis labels: what a column of results is called on paper, with its typeset unit."""

from __future__ import annotations

from flipperctl.api import Measure, registry

_LONG = 10
"""Largest number of characters before the unit on one line [-]."""
SUCCESS, VARIATION = "success", "pitch_variation_100hz"
_WORDS = {
    SUCCESS: "Success [%]",
    VARIATION: r"Pitch variation $\hat{\theta}_\mathrm{R}$ [rad]",
    "pitch_variation": r"Pitch variation $\hat{\theta}_\mathrm{R}$ at decisions [rad]",
    "t_cost": "Time [s]",
    "max_pitch": "Largest pitch [rad]",
    "flipper_travel": "Flipper travel [rad]",
    "return": "Return",
    "loss": "Loss",
    "epsilon": r"Random actions $\varepsilon$",
}


def label(name: str, *, folded: bool = False) -> str:
    """Return the label of an axis that shows a column of results.

    ``folded``: on two lines if it is long, for the vertical axis of a low panel.
    """
    if folded:
        words = label(name)
        at = words.find(" $") if " $" in words else words.find(" [")
        return f"{words[:at]}\n{words[at + 1 :]}" if at > _LONG else words
    if name in _WORDS:
        return _WORDS[name]
    found, words = registry.get((Measure.kind, name)), name.replace("_", " ")
    unit = found.unit if found is not None and issubclass(found, Measure) else "-"
    return f"{words[0].upper()}{words[1:]}" + ("" if unit in ("", "-") else f" [{unit}]")
