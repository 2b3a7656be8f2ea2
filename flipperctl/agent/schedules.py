"""Values that change over a run."""


def linear(start: float, end: float, share: float) -> float:
    """From ``start`` at share 0 to ``end`` at share 1, constant outside."""
    return start + (end - start) * min(1.0, max(0.0, share))
