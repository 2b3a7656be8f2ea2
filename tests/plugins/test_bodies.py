"""Which surfaces of a mesh bound bodies: what lies between sheets that look up alone is ground."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.creation import icosphere
from trimesh.util import concatenate

from tests.plugins.test_layers import terrain_of
from tests.plugins.test_mesh import solid, without, write

ALONG = {"start": (0.1, 0.0), "end": (3.9, 0.0)}


def sheet(z: float, tiles: int = 1, *, down: bool = False) -> Trimesh:
    """Return a level sheet, 4 m × 2 m, of tiles that share their corners' places."""
    x, y = np.linspace(0, 4, tiles + 1), np.linspace(-1, 1, tiles + 1)
    parts = [
        Trimesh([(a, c, z), (b, c, z), (b, d, z), (a, d, z)], [(0, 1, 2), (0, 2, 3)], process=False)
        for a, b in pairwise(x)
        for c, d in pairwise(y)
    ]
    found = concatenate(parts)
    if down:
        found.faces = found.faces[:, ::-1]
    return found


def body(low: float, high: float, x: tuple[float, float] = (1.5, 2.5), y: float = 0.5) -> Trimesh:
    return solid(((x[0], -y, low), (x[1], y, high)))


FLIGHT = [body(0, 0.15 * (step + 1), (1.25 + 0.25 * step, 3)) for step in range(3)]
OPEN = Trimesh(body(0, 0.4).vertices, body(0, 0.4).faces[2:], process=False)  # half a side misses


@pytest.mark.parametrize("suffix", ["stl", "obj"])
@pytest.mark.parametrize(
    ("parts", "highest"),
    [
        ([sheet(0), body(0, 0.4), sheet(3)], 0.4),
        ([sheet(0), body(-0.05, 0.4), sheet(3)], 0.4),  # sunk into the floor
        ([sheet(0), body(0.02, 0.4), sheet(3)], 0.4),
        ([sheet(0, 8), body(0, 0.4), sheet(3)], 0.4),  # its edges are edges of tiles, too
        ([sheet(0, 8), body(0, 0.4, y=1), sheet(3, 8), body(3, 3.5), sheet(6)], 0.4),
        ([sheet(0), body(0, 0.4), body(0, 0.4), sheet(3)], 0.4),  # written twice
        ([sheet(0), *FLIGHT, sheet(3)], 0.45),  # bodies whose ends coincide
        ([sheet(0), body(0, 0.4), body(0.4, 0.6), sheet(3)], 0.6),
        ([sheet(0), OPEN, sheet(3)], 0.4),
        ([sheet(0), without(body(0, 0.4), 0), sheet(3)], 0.4),  # without a bottom
        ([sheet(0), icosphere(radius=0.4).apply_translation((2, 0, 0)), sheet(3)], 0.4),
        ([body(-0.2, 0, (0, 4), 1), body(0, 0.4), sheet(3)], 0.4),
        ([sheet(0), sheet(0, down=True), sheet(3)], 0.0),  # a floor of two sides
        ([sheet(0), body(1.5, 1.6), sheet(3)], 0.0),  # a bridge
        ([sheet(0), body(0.7, 0.75), sheet(3)], 0.75),  # a table
        ([sheet(0), body(0, 3), sheet(3)], 3.0),  # a pillar
        ([sheet(0), body(0, 0.4), sheet(3, down=True)], 0.4),
        ([sheet(0), body(0, 0.4), body(3, 3.2, (0, 4), 1)], 0.4),
        ([sheet(0), body(-0.1, 2)], 2.0),  # walls that stand in sheets
        ([sheet(0, 8), body(0, 2), sheet(4)], 2.0),
    ],
)
def test_a_body_between_sheets_is_ground(
    parts: Sequence[Trimesh], highest: float, suffix: str, tmp_path: Path
) -> None:
    file = tmp_path / f"ground.{suffix}"
    write(file, concatenate(list(parts)))
    terrain = terrain_of(file, **ALONG)
    profile = terrain.generate(np.random.default_rng(0))
    assert profile.points[:, 1].max() == pytest.approx(highest, abs=1e-3)
    assert profile.points[:, 1].min() == pytest.approx(0, abs=1e-6)
    assert not any("not closed" in remark for remark in terrain.notices())
    beside = profile.surface.heights(np.array([-0.3, 0.2]))
    assert np.nanmax(beside) <= highest + 1e-6


def test_a_wall_that_rounding_tilts_is_no_ceiling(tmp_path: Path) -> None:
    # The line runs in a wall between a floor and a higher one; its face looks down by 1 µm.
    wall = Trimesh(
        [(0, 0, 0), (4, 0, 0), (4, -1e-6, 2), (0, -1e-6, 2)], [(0, 1, 2), (0, 2, 3)], process=False
    )
    file = tmp_path / "wall.obj"
    for faces in (wall.faces, wall.faces[:, ::-1]):
        tilted = Trimesh(wall.vertices, faces, process=False)
        write(file, concatenate([sheet(0), tilted, sheet(2), sheet(6)]))
        terrain = terrain_of(file, **ALONG)
        assert np.ptp(terrain.generate(np.random.default_rng(0)).points[:, 1]) == 0
        assert len(terrain.notices()) == 1
