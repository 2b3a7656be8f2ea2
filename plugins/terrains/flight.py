"""The outline of a flight of equal steps."""


def flight(x: float, z: float, steps: int, tread: float, rise: float) -> list[tuple[float, float]]:
    """Return two points (x, z) per step [m], from the foot of the first face to the last edge.

    The flight begins at (x, z) with a vertical face; a negative ``rise`` leads down.
    """
    points = []
    for step in range(steps):
        points.append((x + step * tread, z + step * rise))
        points.append((x + step * tread, z + (step + 1) * rise))
    return points
