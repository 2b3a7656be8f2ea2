"""The outline of a flight of equal steps."""


def flight(
    x: float,
    z: float,
    steps: int,
    tread: float,
    rise: float,
    landing_every: int = 0,
    landing: float = 0.0,
) -> list[tuple[float, float]]:
    """Return two points (x, z) per step [m], from the foot of the first face to the last edge.

    The flight begins at (x, z) with a vertical face; a negative ``rise`` leads down. After every
    ``landing_every`` steps, unless it is 0, a landing of length ``landing`` [m] replaces the tread.
    """
    points = []
    for step in range(steps):
        landings = step // landing_every if landing_every else 0
        edge = x + step * tread + landings * (landing - tread)
        points.append((edge, z + step * rise))
        points.append((edge, z + (step + 1) * rise))
    return points
