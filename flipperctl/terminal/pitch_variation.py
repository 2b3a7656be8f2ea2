"""θ̂_R of a validation in words: at 100 Hz first, at decisions, as in the paper, in brackets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HEADING, PAPERS_HEADING = "θ̂_R [rad]", "θ̂_R at decisions [rad]"
"""Headings of the two columns in tables, in this order."""


def swing_text(measures: Mapping[str, Any], digits: int) -> str:
    """Return both θ̂_R of a validation, as in ``θ̂_R 1.30 rad (1.12 at decisions)``.

    A validation of an earlier version may lack θ̂_R at 100 Hz; then the text has the other alone.
    """
    papers, swing = measures["pitch_variation"], measures.get("pitch_variation_100hz")
    if swing is None:
        return f"θ̂_R at decisions {papers:.{digits}f} rad"
    return f"θ̂_R {swing:.{digits}f} rad ({papers:.{digits}f} at decisions)"
