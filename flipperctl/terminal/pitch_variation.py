"""The text for θ̂_R of a validation: at 100 Hz, and in brackets at decisions, as in the paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

HEADING, PAPERS_HEADING = "θ̂_R [rad]", "θ̂_R at decisions [rad]"
"""Headings of the two columns in tables, in this order."""


def pitch_variation_text(measures: Mapping[str, Any], digits: int) -> str:
    """Return both θ̂_R of a validation, as in ``θ̂_R 1.30 rad (1.12 at decisions)``.

    Validations of earlier versions may lack θ̂_R at 100 Hz; the text then has the other alone.
    """
    papers, at_100hz = measures["pitch_variation"], measures.get("pitch_variation_100hz")
    if at_100hz is None:
        return f"θ̂_R at decisions {papers:.{digits}f} rad"
    return f"θ̂_R {at_100hz:.{digits}f} rad ({papers:.{digits}f} at decisions)"
