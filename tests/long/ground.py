"""Files of recorded ground of every kind to damage, and their profiles as scenes."""

from pathlib import Path

import numpy as np
import rasterio
from pypcd4.pypcd4 import Encoding, PointCloud
from rasterio.transform import from_origin
from trimesh import PointCloud as PlyCloud

from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from tests.plugins.test_mesh import solid, write

LINE = {"start": (0.2, 0.5), "end": (1.8, 0.5)}
LONGEST = 60.0
"""Longest outline on which an episode is begun [m]; a longer one is only generated."""


def files(folder: Path) -> dict[str, bytes]:
    """Write files of all kinds; return their bytes by name."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform((0, 0), (2, 1), (4000, 2)).T
    points = np.column_stack([x, y, np.where(x > 1, 0.1, 0.0)]).astype(np.float32)
    heights = np.tile(np.where(np.arange(41) > 20, 0.1, 0.0), (21, 1))
    (folder / "a.csv").write_text("x,z\n0,0\n0.5,0\n0.5,0.1\n1.25,0.15\n2,0\n")
    (folder / "b.csv").write_text("time;X;Z\r\n1;0;0\r\n2;0,5;0,1\r\n3;1,25;0,15\r\n4;2;0\r\n")
    np.save(folder / "a.npy", heights)
    np.savetxt(folder / "a.xyz", points, fmt="%.3f")
    with rasterio.open(
        folder / "a.tif", "w", driver="GTiff", height=21, width=41, count=1, dtype="float32",
        compress="lzw", transform=from_origin(0, 1, 0.05, 0.05),
    ) as out:  # fmt: skip
        out.write(heights.astype("float32"), 1)
    cloud = PointCloud.from_xyz_points(points)
    for name, encoding in (
        ("a", Encoding.ASCII), ("b", Encoding.BINARY), ("c", Encoding.BINARY_COMPRESSED),
    ):  # fmt: skip
        cloud.save(folder / f"{name}.pcd", encoding)
    for name, how in (("a", "ascii"), ("b", "binary")):
        data = PlyCloud(points).export(file_type="ply", encoding=how)
        (folder / f"{name}.ply").write_bytes(data)
    bodies = solid(((0, 0, 0), (2, 1, 0.1)), ((1, 0, 0), (1.5, 1, 0.2)))
    for suffix in ("stl", "obj", "dae"):
        write(folder / f"a.{suffix}", bodies)
    (folder / "mesh.ply").write_bytes(bodies.export(file_type="ply"))
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def read(path: Path) -> str:
    """Return the profile of a file as text; begin an episode on it unless it is very long."""
    frame = {} if path.suffix == ".csv" else LINE
    more = {"resolution": 0.05} if path.suffix == ".npy" else {}
    settings = {"name": "profile_file", "path": str(path), **frame, **more}
    env = FlipperEnv(resolver.create("terrain", settings, "terrain"))
    profile = env._generate(np.random.default_rng(0), 1.0)
    assert np.isfinite(profile.points).all()
    if profile.surface is not None:
        profile.surface.heights(np.array([-0.3, 0.3]))
    if np.hypot(*np.diff(profile.points, axis=0).T).sum() < LONGEST:
        env.reset(seed=0)
    return str(profile.points.tolist())
