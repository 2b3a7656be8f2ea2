"""Ground from meshes: the topmost faces are the outline, and what is not closed is refused."""

import sys
from pathlib import Path

import numpy as np
import pytest
from flipperctl_plugins.recorded_ground.dae import read_dae
from trimesh import Trimesh
from trimesh.creation import box
from trimesh.util import concatenate

from flipperctl.errors import TerrainError
from tests.plugins.test_profile_file import LINE, assert_block, profile

_DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{numbers}">{points}</float_array><technique_common>
<accessor source="#a" count="{count}" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="{faces}"><input semantic="VERTEX" source="#v" offset="0"/><p>{indices}</p>
</triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def solid(*bounds: tuple[tuple[float, float, float], tuple[float, float, float]]) -> Trimesh:
    """Return closed boxes, each from its lower to its upper corner."""
    return concatenate([box(bounds=pair) for pair in bounds])


def block() -> Trimesh:
    """Return ground at 7 m, 4 m × 3 m, and on it the block of ``assert_block``."""
    return solid(((0, 0, 6), (4, 3, 7)), ((1.5, 0, 6.9), (2.5, 3, 7.3)))


def write(file: Path, mesh: Trimesh, unit: float = 1.0, up: str = "Z_UP") -> None:
    """Write the mesh in the format of the file's suffix."""
    points = np.asarray(mesh.vertices) / unit
    if file.suffix != ".dae":
        made = Trimesh(points, mesh.faces, process=False).export(file_type=file.suffix[1:])
        file.write_bytes(made.encode() if isinstance(made, str) else made)
        return
    file.write_text(
        _DAE.format(
            unit=unit,
            up=up,
            count=len(points),
            numbers=points.size,
            points=" ".join(map(repr, points.ravel().tolist())),
            faces=len(mesh.faces),
            indices=" ".join(map(str, np.asarray(mesh.faces).ravel().tolist())),
        )
    )


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae"])
def test_the_topmost_faces_along_the_line_are_the_outline(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"block.{suffix}"
    write(file, block())
    assert_block(profile(file, **LINE), 0.02)


def test_a_mesh_has_the_unit_and_the_axes_that_are_stated(tmp_path: Path) -> None:
    # With y up, a right-handed frame has z and x as its level axes: (x, y, z) are (y, z, x) there.
    turned = block()
    turned.vertices = np.asarray(turned.vertices)[:, [1, 2, 0]]
    write(tmp_path / "feet.obj", turned, 0.3048)
    assert_block(profile(tmp_path / "feet.obj", unit="ft", up="y", **LINE), 0.02)
    write(tmp_path / "inches.dae", turned, 0.0254, "Y_UP")
    assert_block(profile(tmp_path / "inches.dae", **LINE), 0.02)
    write(tmp_path / "negative.dae", turned, -1.0, "Y_UP")
    with pytest.raises(TerrainError, match=r"states a unit of -1 m; terrain\.unit prevails"):
        profile(tmp_path / "negative.dae", **LINE)


def test_a_dae_is_read_by_the_names_of_its_coordinates_and_by_the_places_of_its_parts(
    tmp_path: Path,
) -> None:
    # The file holds y, x and z; its node turns them by 90°, one within stretches them upwards.
    file, sheet = tmp_path / "sheet.dae", Trimesh([(0, 0, 7), (3, 0, 7), (0, 4, 7)], [(0, 1, 2)])
    write(file, sheet)
    text = file.read_text().replace('"X"', '"x"').replace('"Y"', '"X"').replace('"x"', '"Y"')
    text = text.replace('<node id="n">', '<node id="n"><translate>4 0 0</translate>{}')
    turn = '<rotate>0 0 1 90</rotate><node><scale>1 1 2</scale><instance_geometry url="#g"/></node>'
    file.write_text(
        text.replace("{}", turn).replace('</node><instance_geometry url="#g"/>', "</node>")
    )
    corners = [[(4, 0, 14), (1, 0, 14), (4, 4, 14)]]
    assert read_dae(file).corners == pytest.approx(np.array(corners), abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('<node id="n">', '<node id="n"><skew>1</skew>', r"places .* cannot be read: .*skew"),
        ('<scene><instance_visual_scene url="#s"/></scene>', "", "it has no scene"),
        ("<COLLADA", "<COLLADA <", "it is not XML"),
        ("</p>", " 0</p>", "faces of g cannot be read: they have 73 corners, and 75 are needed"),
        ('count="48">0.0', 'count="48">nan', "a coordinate of the mesh is not a finite number"),
        (' meter="1.0"', ' meter="inch"', "it states a unit of 'inch'; a number of metres is"),
    ],
)
def test_what_cannot_be_read_of_a_dae_is_refused_with_its_number_of_faces(
    old: str, new: str, error: str | None, tmp_path: Path
) -> None:
    file = tmp_path / "block.dae"
    write(file, block())
    file.write_text(file.read_text().replace(old, new))
    if error is None:
        assert_block(profile(file, **LINE), 0.02)
        return
    with pytest.raises(TerrainError, match=error):
        profile(file, **LINE)


def without(mesh: Trimesh, z: float) -> Trimesh:
    """Return the mesh without its level faces at height z [m]."""
    level = (np.abs(np.asarray(mesh.triangles)[:, :, 2] - z) < 1e-6).all(axis=1)
    return Trimesh(mesh.vertices, mesh.faces[~level], process=False)


def test_a_mesh_that_is_not_closed_below_the_line_is_refused(tmp_path: Path) -> None:
    # Through the hole in the middle body's top its bottom is seen from behind.
    bodies = [((0, 0, 6), (1.6, 3, 7)), ((1.6, 0, 6), (2.4, 3, 7.3)), ((2.4, 0, 6), (4, 3, 7))]
    file = tmp_path / "hole.stl"
    write(file, solid(*bodies))
    assert profile(file, **LINE).height(1.0) == pytest.approx(0.3, abs=1e-6)
    write(file, without(solid(*bodies), 7.3))
    with pytest.raises(TerrainError, match=r"the mesh is not closed from 0\.60 to 1\.4\d m along"):
        profile(file, **LINE)
    assert profile(file, largest_gap=1.0, **LINE).height(1.0) == pytest.approx(0.0, abs=1e-6)


def test_faces_that_look_down_and_a_line_outside_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "block.stl"
    inverted = block()
    inverted.faces = inverted.faces[:, ::-1]
    write(file, inverted)
    with pytest.raises(TerrainError, match="the mesh is inside out: it is closed and"):
        profile(file, **LINE)
    sheet = Trimesh([(0, 0, 7), (4, 0, 7), (4, 3, 7), (0, 3, 7)], [(0, 2, 1), (0, 3, 2)])
    write(file, sheet)
    with pytest.raises(
        TerrainError, match=r"all faces along the line .* look down: the mesh is fl"
    ):
        profile(file, **LINE)
    write(file, block())
    with pytest.raises(TerrainError, match=r"\(5\.0, 2\.0\) lies outside the mesh.* to 4\.00 m"):
        profile(file, start=(1.0, 2.0), end=(5.0, 2.0))


def test_a_mesh_that_is_too_large_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "block.stl"
    write(file, block())  # 2 bodies of 12 faces
    assert profile(file, largest_mesh=24, **LINE).end == pytest.approx(2.0)
    with pytest.raises(TerrainError, match="too large: it has 24 faces; largest_mesh allows 23"):
        profile(file, largest_mesh=23, **LINE)
    with file.open("ab") as out:
        out.truncate(2_000_000)
    with pytest.raises(TerrainError, match="too large: 2 MB for largest_mesh of 3000 faces"):
        profile(file, largest_mesh=3000, **LINE)


@pytest.mark.parametrize(
    ("suffix", "content"), [("stl", b""), ("obj", b"no mesh"), ("dae", b"\0\xff" * 200)]
)
def test_a_damaged_mesh_is_named_in_one_line(suffix: str, content: bytes, tmp_path: Path) -> None:
    file = tmp_path / f"bad.{suffix}"
    file.write_bytes(content)
    with pytest.raises(TerrainError) as caught:
        profile(file, **LINE)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_reader_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "block.stl"
    write(file, block())
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(TerrainError, match=r"need trimesh: pip install 'flipperctl\[profiles\]'"):
        profile(file, **LINE)
