"""The faces of a Collada file, whatever its materials, textures and effects are.

In: a DAE file. Out: triangles in the file's frame and unit, and both as the file states them. Only
what says where faces are is handed to pycollada, which leaves out each part that has anything else
that it cannot read; what it then leaves out is an error.
"""

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import FloatArray

_FACES = {"triangles", "tristrips", "trifans", "polylist", "polygons"}
_KEPT: dict[str, set[str]] = {
    "COLLADA": {"asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene"},
    "scene": {"instance_visual_scene"},
    "visual_scene": {"node"},
    "node": {
        *("node", "instance_node", "instance_geometry"),
        *("matrix", "translate", "rotate", "scale", "lookat", "skew"),
    },
    "geometry": {"mesh", "convex_mesh", "spline", "brep"},
    "mesh": {"source", "vertices", *_FACES},
    "instance_geometry": set(),
    "instance_node": set(),
}
"""Element → those inside it that say where faces are; of other elements all are kept."""


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
    import collada

    try:
        root = ET.fromstring(path.read_bytes())  # noqa: S314  # pycollada parses it as well
    except ET.ParseError as error:
        raise ValueError(f"it is not XML: {error}") from error
    if _name(root) != "COLLADA":
        raise ValueError(f"it is no Collada file: its outermost element is {_name(root)!r}")
    reason = "skins (instance_controller) are not read" if _all(root, "instance_controller") else ""
    _strip(root)
    try:
        file = collada.Collada(io.BytesIO(ET.tostring(root)), ignore=[collada.common.DaeError])
    except collada.common.DaeError as error:
        raise ValueError(f"it cannot be read: {error.msg}") from error
    reason = next((error.msg for error in file.errors), reason)
    if file.scene is None and not reason:
        raise ValueError("it has no scene, which says where its parts are (instance_visual_scene)")
    nodes = [] if file.scene is None else file.scene.nodes
    parts = [part for node in nodes for part in _parts(node, np.eye(4))]
    if reason:
        faces = {each.get("id"): _count(each) for each in _all(root, "geometry")}
        missing = sum(faces.values()) - sum(faces.get(name, 0) for name in {n for n, _ in parts})
        raise ValueError(
            f"{missing} of its {sum(faces.values())} faces cannot be read: {reason}"
            if missing
            else f"the places of its parts cannot be read: {reason}"
        )
    corners = np.concatenate([np.empty((0, 3, 3)), *(corners for _, corners in parts)])
    asset = file.assetInfo
    return DaeFile(corners, float(asset.unitmeter or 1.0), str(asset.upaxis or "Y_UP"))


def _parts(node: Any, matrix: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the name and the triangles (T, 3, 3) of each geometry below a node of a scene."""
    from collada.scene import GeometryNode

    if isinstance(node, GeometryNode):
        for primitive in node.geometry.primitives:
            if hasattr(primitive, "triangleset"):  # of polygons
                primitive = primitive.triangleset()
            places = np.asarray(primitive.vertex, dtype=np.float64)[primitive.vertex_index]
            yield node.geometry.id, places @ matrix[:3, :3].T + matrix[:3, 3]
        return
    for child in node.children:
        yield from _parts(child, matrix @ np.asarray(node.matrix, dtype=np.float64))


def _strip(element: ET.Element) -> None:
    """Remove what does not say where faces are: looks, normals, lines, lights, remarks."""
    name, children = _name(element), list(element)
    if name == "vertices":
        kept = [child for child in children if child.get("semantic") == "POSITION"]
    elif name in _FACES:
        kept = _corners_alone(children)
    elif name in _KEPT:
        kept = [child for child in children if _name(child) in _KEPT[name]]
    else:
        kept = children
    element[:] = kept
    for child in kept:
        _strip(child)
    if name == "mesh":
        used = {each.get("source", "")[1:] for each in _all(element, "input")}
        if absent := used - {child.get("id") for child in kept}:
            faces = _count(element)
            raise ValueError(f"{faces} of its faces cannot be read: {absent} is not in their mesh")
        element[:] = [
            child
            for child in kept
            if (_name(child) != "source" or child.get("id") in used)
            and (_name(child) not in _FACES or _count(child))
        ]


def _corners_alone(children: list[ET.Element]) -> list[ET.Element]:
    """Return the parts of a list of faces whose indices are those of corners alone."""
    inputs = [child for child in children if _name(child) == "input"]
    corner = [child for child in inputs if child.get("semantic") == "VERTEX"]
    if len(corner) != 1 or not all(child.get("offset", "").isdigit() for child in inputs):
        return children  # which is refused
    size = max(int(child.get("offset", "")) for child in inputs) + 1
    at = int(corner[0].get("offset", ""))
    corner[0].set("offset", "0")
    rest = [child for child in children if _name(child) in ("vcount", "p", "ph")]
    for child in rest:
        for each in child.iter():
            if _name(each) in ("p", "h"):
                each.text = " ".join((each.text or "").split()[at::size])
    return [*corner, *rest]


def _count(element: ET.Element) -> int:
    """Return the number of faces in an element, whose indices are those of corners alone."""
    total = 0
    for each in element.iter():
        indices = [len((p.text or "").split()) for p in each if _name(p) in ("p", "ph")]
        if _name(each) == "triangles":
            total += sum(indices) // 3
        elif _name(each) in ("tristrips", "trifans"):
            total += sum(max(0, count - 2) for count in indices)
        elif _name(each) == "polygons":
            total += len(indices)
        elif _name(each) == "vcount":
            total += len((each.text or "").split())
    return total


def _all(root: ET.Element, name: str) -> list[ET.Element]:
    return [each for each in root.iter() if _name(each) == name]


def _name(element: ET.Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]
