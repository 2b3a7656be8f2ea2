"""What robot and ground look like in 3-D: closed shapes, and edges that can be told apart."""

import math

import numpy as np
import pytest

from flipperctl.api import Profile, Robot
from flipperctl.sim.mujoco import Mujoco
from flipperctl.sim.mujoco.appearance import (
    Mesh,
    ground_meshes,
    grousers,
    profile_line,
    robot_meshes,
    tracks,
)
from flipperctl.sim.mujoco.ground import lay
from flipperctl.sim.outline import BELT, CHASSIS, FRONT, GROUND, REAR

STEP = Profile([(0.0, 0.0), (0.0, 0.2), (1.0, 0.2)])


def volume(mesh: Mesh) -> float:
    """Return the volume inside a closed mesh, negative if its faces look inward [m³]."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6


def areas(mesh: Mesh) -> dict[tuple[int, ...], float]:
    """Return the area of the faces in each direction, rounded [m²]."""
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    sizes = np.linalg.norm(normals, axis=1)
    found: dict[tuple[int, ...], float] = {}
    for normal, size in zip(normals, sizes, strict=True):
        key = tuple(int(n) for n in np.round(normal / size))
        found[key] = found.get(key, 0.0) + float(size) / 2
    return found


def test_the_robot_is_closed_shapes_in_the_colours_of_the_side_view() -> None:
    robot, found = Robot(), list(robot_meshes(Robot(), Mujoco()))
    colours = {body: {mesh.colour for name, mesh in found if name == body} for body, _ in found}
    assert colours["front_left"] == colours["front_right"] == {BELT, FRONT}
    assert colours["rear_left"] == {BELT, REAR}
    assert {BELT, CHASSIS} < colours["chassis"]
    # A stadium of 0.336 m between round ends of 0.1 m, 24 chords of which lie within the arcs
    (belt,) = (m for name, m in found if (name, m.colour) == ("front_left", BELT))
    ends = 12 * math.sin(math.pi / 12) * robot.track_radius**2
    assert volume(belt) == pytest.approx((0.336 * 0.2 + ends) * 0.18)
    assert belt.triangles[..., 0].max() == pytest.approx(0.436)
    assert all(volume(mesh) > 0 for _, mesh in found)


def test_bars_run_along_the_belt_with_its_travel() -> None:
    track = next(track for track in tracks(Robot(), Mujoco()) if track.body == "front_left")
    still, slopes = grousers(track, Robot(), 0.0)
    moved, _ = grousers(track, Robot(), 0.05)
    assert still[0] == pytest.approx([0.0, 0.1])  # above the hinge
    assert moved[0] == pytest.approx([0.05, 0.1])
    assert slopes[0] == pytest.approx(0.0)


def test_a_step_has_a_riser_of_another_colour_and_lines_at_its_edges() -> None:
    strips = lay(STEP, Mujoco(), np.random.default_rng(0)).strips
    meshes = {mesh.colour: areas(mesh) for mesh in ground_meshes(strips, -0.7, 2.0)}
    (riser,) = (faces for faces in meshes.values() if set(faces) == {(-1, 0, 0)})
    assert riser[-1, 0, 0] == pytest.approx(0.2 * 2.7)
    (treads,) = (faces for faces in meshes.values() if set(faces) == {(0, 0, 1)})
    assert treads[0, 0, 1] == pytest.approx(41 * 2.7)  # 20 m of level ground at each end
    assert GROUND in meshes
    shading = {mesh.colour: mesh.shades for mesh in ground_meshes(strips, -0.7, 2.0)}
    assert [meshes[colour] for colour, shades in shading.items() if not shades] == [treads]
    right, left = (ground_meshes(strips, *between) for between in ((-2.0, -0.7), (-0.7, 2.0)))
    assert max(mesh.triangles[..., 1].max() for mesh in right) == pytest.approx(-0.7)
    assert min(mesh.triangles[..., 1].min() for mesh in left) == pytest.approx(-0.7)
    line = profile_line(strips, -0.7).triangles
    assert line[..., 2].min() == pytest.approx(-0.006)
    assert line[..., 2].max() == pytest.approx(0.206)
