"""The faces of a Collada file, whatever its materials, textures and effects are.

In: a DAE file. Out: triangles in the file's frame and unit, and both as the file states them. Only
what says where faces are is handed to pycollada, which leaves out each part that has anything else
that it cannot read; what it then leaves out is an error.
"""

import io
import re
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
    if not re.fullmatch(r"\{.+\}COLLADA", root.tag):
        raise ValueError(
            f"it is no Collada file: its outermost element is {root.tag!r}; COLLADA in the "
            "namespace (xmlns) of its version is allowed"
        )
    reason = "skins (instance_controller) are not read" if _all(root, "instance_controller") else ""
    _strip(root)
    faces = {each.get("id"): _count(each) for each in _all(root, "geometry")}
    try:
        file = collada.Collada(io.BytesIO(ET.tostring(root)), ignore=[collada.common.DaeError])
    except (collada.common.DaeError, ValueError) as error:
        text = getattr(error, "msg", error)
        raise ValueError(f"none of its {sum(faces.values())} faces can be read: {text}") from error
    reason = next((error.msg for error in file.errors), reason)
    if file.scene is None and not reason:
        raise ValueError("it has no scene, which says where its parts are (instance_visual_scene)")
    nodes = [] if file.scene is None else file.scene.nodes
    parts = [part for node in nodes for part in _parts(node, np.eye(4))]
    read = {name: count for name, count, _ in parts}
    if any(count < faces[name] for name, count in read.items()):
        reason = reason or "those with holes are not read"
    if reason:
        missing = sum(faces.values()) - sum(read.values())
        raise ValueError(
            f"{missing} of its {sum(faces.values())} faces cannot be read: {reason}"
            if missing
            else f"the places of its parts cannot be read: {reason}"
        )
    corners = np.concatenate([np.empty((0, 3, 3)), *(corners for *_, corners in parts)])
    # pycollada takes 1 m and Y_UP for what it does not understand.
    stated = {_name(each): each for asset in root if _name(asset) == "asset" for each in asset}
    unit = stated["unit"].get("meter", "1") if "unit" in stated else "1"
    up = (stated["up_axis"].text or "").strip() if "up_axis" in stated else "Y_UP"
    try:
        return DaeFile(corners, float(unit), up)
    except ValueError:
        raise ValueError(f"it states a unit of {unit!r}; a number of metres is allowed") from None


def _parts(node: Any, matrix: FloatArray) -> Iterator[tuple[str, int, FloatArray]]:
    """Yield name, number of all faces, and triangles (T, 3, 3) of each geometry below a node."""
    from collada.scene import GeometryNode

    if isinstance(node, GeometryNode):
        faces = sum(map(len, node.geometry.primitives))
        for primitive in node.geometry.primitives:
            if hasattr(primitive, "triangleset"):  # of polygons
                primitive = primitive.triangleset()
            indices = primitive.vertex_index if len(primitive) else np.empty((0, 3), np.int64)
            if indices.min(initial=0) < 0:
                raise ValueError(f"a corner of {node.geometry.id} has the index {indices.min()}")
            places = np.asarray(primitive.vertex, dtype=np.float64)[indices]
            yield node.geometry.id, faces, places @ matrix[:3, :3].T + matrix[:3, 3]
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
        _check_finite(element)


def _check_finite(mesh: ET.Element) -> None:
    """Refuse coordinates that are no finite numbers; pycollada takes 0 for NaN."""
    for each in _all(mesh, "float_array"):
        try:
            values = np.array((each.text or "").split(), dtype=np.float64)
            finite = bool(np.isfinite(values).all())
        except ValueError:
            finite = False
        if not finite:
            raise ValueError(
                f"{_count(mesh)} of its faces cannot be read: a coordinate of {each.get('id')} is "
                "no finite number"
            )


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
