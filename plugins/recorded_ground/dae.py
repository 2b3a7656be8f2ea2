"""The faces of a Collada file, whatever its materials, textures and effects are.

In: a DAE file. Out: triangles in the file's frame and unit, and both as the file states them. Only
what says where faces are is read, and what cannot be read of that is an error.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray

_FACES = ("triangles", "tristrips", "trifans", "polylist", "polygons")


@dataclass(frozen=True)
class DaeFile:
    """Faces, and what the file states about them."""

    corners: FloatArray
    """(T, 3, 3): triangle, corner, coordinate in the file's frame and unit."""
    unit: float
    """Unit [m]."""
    up: str
    """Axis that points up, such as Y_UP."""


def read_dae(path: Path) -> DaeFile:
    """Read the faces of the file's scene.

    Raises:
        ValueError: it is no Collada file, has no scene, or faces of it cannot be read.
    """
    try:
        root = ET.fromstring(path.read_bytes())  # noqa: S314  # expat limits what entities expand
    except ET.ParseError as error:
        raise ValueError(f"it is not XML: {error}") from error
    for element in root.iter():
        element.tag = str(element.tag).rpartition("}")[2]  # of all namespaces
    if root.tag != "COLLADA":
        raise ValueError(f"it is no Collada file: its outermost element is {root.tag!r}")
    scene = root.find("scene/instance_visual_scene")
    if scene is None:
        raise ValueError("it has no scene, which says where its parts are (instance_visual_scene)")

    # Parts are placed by the nodes above them, and may be placed several times.
    nodes, geometries = list(root.iter("node")), list(root.iter("geometry"))

    @cache  # may be in several places
    def faces_of(url: str | None) -> FloatArray:
        return _faces(_find(geometries, url))

    def placed(node: ET.Element, matrix: FloatArray) -> Iterator[FloatArray]:
        """Yield the triangles, (T, 3, 3), of each geometry below a node, whose frame is (4, 4)."""
        for child in node:  # transforms come before what they move
            if child.tag == "node":
                yield from placed(child, matrix)
            elif child.tag == "instance_node":
                yield from placed(_find(nodes, child.get("url")), matrix)
            elif child.tag == "instance_geometry":
                yield faces_of(child.get("url")) @ matrix[:3, :3].T + matrix[:3, 3]
            elif child.tag == "instance_controller":
                raise ValueError("skins (instance_controller) are not read")
            else:
                matrix = matrix @ _transform(child)

    # The scene in the file's own unit and axis
    scenes = list(root.iter("visual_scene"))
    parts = placed(_find(scenes, scene.get("url")), np.eye(4))
    corners = np.concatenate([np.empty((0, 3, 3)), *parts])
    unit, up = root.find("asset/unit"), root.findtext("asset/up_axis", "Y_UP")
    metres = "1" if unit is None else unit.get("meter", "1")
    try:
        return DaeFile(corners, float(metres), up.strip())
    except ValueError:
        text = f"it states a unit of {metres!r}; a number of metres is allowed"
        raise ValueError(text) from None


def _find(elements: Sequence[ET.Element], url: str | None) -> ET.Element:
    """Return the element to which a reference such as ``#part`` points."""
    matches = [element for element in elements if f"#{element.get('id')}" == url]
    if len(matches) != 1:
        raise ValueError(f"{len(matches)} of its parts have the id {url}; 1 is needed")
    return matches[0]


def _transform(element: ET.Element) -> FloatArray:
    """Return the matrix (4, 4) of a transform; other elements move nothing."""
    matrix = np.eye(4)
    if element.tag == "matrix":
        matrix = _numbers(element).reshape(4, 4)
    elif element.tag == "translate":
        matrix[:3, 3] = _numbers(element)
    elif element.tag == "scale":
        matrix[:3, :3] = np.diag(_numbers(element))
    elif element.tag == "rotate":
        from scipy.spatial.transform import Rotation

        x, y, z, degrees = _numbers(element)
        turn = np.radians(degrees) / np.linalg.norm((x, y, z)) * np.array([x, y, z])
        matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    elif element.tag in ("lookat", "skew"):
        raise ValueError(f"the places of its parts cannot be read: {element.tag} is not supported")
    return matrix


def _faces(geometry: ET.Element) -> FloatArray:
    """Return the triangles of a geometry, (T, 3, 3); an error states its number of faces."""
    count = sum(int(each.get("count", "0")) for each in geometry.iter() if each.tag in _FACES)
    mesh = geometry.find("mesh")
    try:
        if mesh is None:
            raise ValueError("it is no mesh")
        parts = [_triangles(mesh, faces) for faces in mesh if faces.tag in _FACES]
    except (ValueError, IndexError) as error:
        name = geometry.get("id")
        raise ValueError(f"{count} faces of {name} cannot be read: {error}") from error
    return np.concatenate([np.empty((0, 3, 3)), *parts])


def _triangles(mesh: ET.Element, faces: ET.Element) -> FloatArray:
    """Return the triangles of a list of faces, (T, 3, 3)."""
    inputs = faces.findall("input")
    size = 1 + max((int(each.get("offset", "0")) for each in inputs), default=0)
    # Indices of corners stand between indices of normals and the like.
    corner = next((each for each in inputs if each.get("semantic") == "VERTEX"), None)
    if faces.find("ph") is not None:
        raise ValueError("those with holes are not read")
    if corner is None:
        raise ValueError("they have no corners (VERTEX)")
    at = int(corner.get("offset", "0"))
    lists = [_numbers(each)[at::size].astype(np.int64) for each in faces.findall("p")]
    corners, counts = (
        np.concatenate([np.empty(0, np.int64), *lists]),
        np.array(list(map(len, lists))),
    )

    # How many corners each face has
    if faces.tag == "triangles":
        counts = np.full(-(-len(corners) // 3), 3)
    elif faces.tag == "polylist":
        counts = np.concatenate([_numbers(each).astype(np.int64) for each in faces.iter("vcount")])
    if counts.sum() != len(corners):
        raise ValueError(f"they have {len(corners)} corners, and {counts.sum()} are needed")
    if corners.min(initial=0) < 0:
        raise ValueError(f"a corner has the index {corners.min()}")
    triangles = corners[_cut(counts, is_strip=faces.tag == "tristrips")]
    return np.asarray(_places(mesh, corner)[triangles])


def _cut(counts: NDArray[np.int64], *, is_strip: bool) -> NDArray[np.int64]:
    """Return the triangles, (T, 3), of polygons in succession, each with some corners.

    A polygon is cut from its first corner. In a strip each corner ends a triangle with the two
    before it, and every other triangle turns the other way.
    """
    triangles = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, triangles)
    number = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    if not is_strip:
        return np.column_stack([first, first + number + 1, first + number + 2])
    first, turned = first + number, number % 2
    return np.column_stack([first, first + 1 + turned, first + 2 - turned])


def _places(mesh: ET.Element, corner: ET.Element) -> FloatArray:
    """Return the places, (V, 3), to which the indices of corners point."""
    vertices = _find(mesh.findall("vertices"), corner.get("source"))
    inputs = {each.get("semantic"): each.get("source") for each in vertices.findall("input")}
    source = _find(mesh.findall("source"), inputs.get("POSITION"))
    accessor, numbers = source.find(".//accessor"), source.find("float_array")
    if accessor is None or numbers is None:
        raise ValueError(f"the places {source.get('id')} are no numbers")
    names = [each.get("name", "").upper() for each in accessor.findall("param")]
    begin, stride = int(accessor.get("offset", "0")), int(accessor.get("stride", "1"))
    columns = [names.index(axis) if axis in names else at for at, axis in enumerate("XYZ")]
    return _numbers(numbers)[begin:].reshape(-1, stride)[:, columns]


def _numbers(element: ET.Element) -> FloatArray:
    return np.array((element.text or "").split(), dtype=np.float64)
