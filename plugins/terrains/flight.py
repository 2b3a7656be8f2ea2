"""The outline of a flight of equal steps."""


def flight(x: float, z: float, steps: int, tread: float, rise: float) -> list[tuple[float, float]]:
    """Two points a step: (x, z), where a vertical face begins the flight, to its last edge [m].

    ``rise`` below zero leads down.
    """
    points = []
    for step in range(steps):
        points.append((x + step * tread, z + step * rise))
        points.append((x + step * tread, z + (step + 1) * rise))
    return points
