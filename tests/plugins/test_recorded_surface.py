"""The ground beside the line of a map or a mesh, which the 3-D engine drives over."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trimesh import Trimesh

from flipperctl.api import Profile, Surface
from flipperctl.config import resolver
from tests.cli.call import call
from tests.plugins.test_mesh import solid, write
from tests.plugins.test_profile_file import LINE, scanned, write_cloud

DIAGONAL = {"start": (1.0, 1.0), "end": (2.0, 2.0)}


def generated(path: Path, **fields: Any) -> Profile:
    settings = {"name": "profile_file", "path": str(path), **fields}
    return resolver.create("terrain", settings, "terrain").generate(np.random.default_rng(0))


def surface(path: Path, **fields: Any) -> Surface:
    found = generated(path, **fields).surface
    assert found is not None
    return found


def plane(file: Path) -> dict[str, Any]:
    """Write ground of z = 0.1 x + 0.3 y, 4 m × 4 m; return the settings that it needs."""
    if file.suffix == ".stl":
        corners = [(0, 0, 0.0), (4, 0, 0.4), (4, 4, 1.6), (0, 4, 1.2)]
        write(file, Trimesh(corners, [(0, 1, 2), (0, 2, 3)]))
        return {}
    y, x = np.mgrid[0:4.01:0.25, 0:4.01:0.25]
    np.save(file, 0.1 * x + 0.3 * y)
    return {"resolution": 0.25}


@pytest.mark.parametrize("name", ["plane.npy", "plane.stl"])
def test_heights_beside_any_line_are_those_of_the_ground(name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    found = surface(file, **plane(file), **DIAGONAL)
    # Along the diagonal it rises by 0.4 / √2 for each metre, to the left of it by 0.2 / √2.
    y = np.array([-0.5, 0.0, 1.0])
    expected = (0.4 * found.x[:, None] + 0.2 * y) / np.sqrt(2)
    assert found.heights(y) == pytest.approx(expected, abs=1e-6)
    assert found.x[[0, -1]] == pytest.approx([0.0, np.sqrt(2)])


@pytest.mark.parametrize("name", ["plane.npy", "plane.stl"])
def test_the_ground_is_unknown_outside_of_the_file(name: str, tmp_path: Path) -> None:
    file = tmp_path / name
    found = surface(file, **plane(file), start=(1.0, 3.5), end=(3.0, 3.5))
    heights = found.heights(np.array([-0.4, 0.4, 0.6]))
    assert np.isfinite(heights).all(axis=0).tolist() == [True, True, False]
    assert heights[0, :2] == pytest.approx([-0.12, 0.12], abs=1e-6)


def test_gaps_beside_the_line_are_bridged_as_on_it(tmp_path: Path) -> None:
    # The body's top is missing for x from 1.5 to 2.5 m, left of the line by 0.2 m and more.
    file = tmp_path / "hole.stl"
    write(
        file,
        solid(((0, 0, 0), (4, 2.2, 1)), ((0, 2.2, 0), (1.5, 4, 1)), ((2.5, 2.2, 0), (4, 4, 1.1))),
    )
    y = np.array([0.0, 0.3])
    unknown = np.isnan(surface(file, **LINE).heights(y))
    assert unknown.sum(axis=0).tolist() == [0, pytest.approx(50, abs=2)]
    bridged = surface(file, **LINE, largest_gap=1.1).heights(y)
    assert bridged[50] == pytest.approx([0.0, 0.05], abs=2e-3)  # half way to 0.1 m


def test_a_surface_is_read_once_and_travels_to_other_processes(tmp_path: Path) -> None:
    file = tmp_path / "plane.npy"
    terrain = resolver.create(
        "terrain", {"name": "profile_file", "path": str(file), **plane(file), **DIAGONAL}, "terrain"
    )
    first = terrain.generate(np.random.default_rng(0)).surface
    y = np.array([0.1, 0.2])
    heights = first.heights(y)
    copied = pickle.loads(pickle.dumps(terrain)).generate(np.random.default_rng(0)).surface
    file.unlink()
    for found in (first, copied):
        assert np.array_equal(found.heights(y), heights)
        with pytest.raises(ValueError, match=r"plane\.npy: there is no such file"):
            found.heights(2 * y)
        assert np.array_equal(found.heights(y), heights)


def test_mirrors_and_labels_keep_the_surface_and_profiles_have_none(tmp_path: Path) -> None:
    file = tmp_path / "plane.npy"
    inner = {"name": "profile_file", "path": str(file), **plane(file), **DIAGONAL}
    mirror = resolver.create("terrain", {"name": "mirror", "terrain": inner}, "terrain")
    found = mirror.labelled(np.random.default_rng(0))
    y = np.array([-0.2, 0.5])
    expected = -(0.4 * found.surface.x[:, None] + 0.2 * y) / np.sqrt(2)
    assert found.surface.heights(y) == pytest.approx(expected, abs=1e-6)
    write_cloud(tmp_path / "scan.xyz", scanned())
    assert generated(tmp_path / "scan.xyz", **LINE).surface is None


def test_eval_drives_over_the_surface_in_3d_alone(tmp_path: Path) -> None:
    # Level below the line; from 0.2 m to its left a wall 0.9 m high stops the robot.
    y = np.arange(0, 4.01, 0.05)[:, None]
    np.save(tmp_path / "wall.npy", np.where(y > 2.2, 0.9, 0.0) + np.zeros(81))
    asked = ["eval", "--controller", "level", "--episodes", "1", "--json", "terrain=profile_file"]
    asked += ["terrain.path=wall.npy", "terrain.resolution=0.05"]
    in_the_middle = ["terrain.start=[1,2]", "terrain.end=[3,2]"]
    plane, space = (
        json.loads(call(*asked, *in_the_middle, f"sim={sim}", cwd=tmp_path).out)
        for sim in ("planar", "mujoco")
    )
    assert plane["scenes"][0]["success_rate"] == 1.0
    assert space["scenes"][0]["success_rate"] == 0.0
    at_the_border = "terrain.end=[3,3.8]"
    done = call(*asked, "terrain.start=[1,3.8]", at_the_border, "sim=mujoco", cwd=tmp_path)
    assert done.code == 2
    assert "the ground is unknown 0.00 m along the line and 0.30 m to its left" in done.err
    assert call(*asked, "terrain.start=[1,3.8]", at_the_border, cwd=tmp_path).code == 0
