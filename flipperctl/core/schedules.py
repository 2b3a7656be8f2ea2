"""Schedules of settings over a run."""


def linear(start: float, end: float, fraction: float) -> float:
    """Interpolate from ``start`` at fraction 0 to ``end`` at fraction 1, constant outside."""
    return start + (end - start) * min(1.0, max(0.0, fraction))
