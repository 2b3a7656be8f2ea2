"""Damages files by the thousand and counts the results of reading them with flipperctl.

    python -m tests.long.files --count 2000 --seed 1 --kind checkpoint,onnx,ground

A damaged file must be refused by one clear error, or be read as the original; a recording and a
file with a new checksum may also be read as something else. Everything else is a violation, for
which the exit code is 1.
"""

import argparse
import contextlib
import faulthandler
import io
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rasterio
import torch
from pypcd4.pypcd4 import Encoding, PointCloud
from rasterio.transform import from_origin
from trimesh import PointCloud as PlyCloud

from flipperctl.config import resolver
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import FlipperctlError
from flipperctl.plugging import plugins
from tests.long import signed
from tests.long.mutations import BYTES, Rng, number_at_the_start
from tests.plugins.test_mesh import solid, write

KINDS = ("checkpoint", "onnx", "ground")
VERDICTS = ("refused", "equal", "other", "silent", "traceback", "noise", "hang")
BAD = VERDICTS[3:]
Verdict = tuple[str, str]
"""One of ``VERDICTS``, and a text."""
Case = tuple[str, Callable[[Rng], bytes], str, bool]
"""Name of the mutation; the mutant; name of the original; whether it may be read as another."""


LIMIT = 20.0
"""Longest time of a case [s]."""
MEMORY = 3 << 30
"""Address space that a case may use beyond that of this process [B]."""
LINE = {"start": (0.2, 0.5), "end": (1.8, 0.5)}
LONGEST = 60.0
"""Longest outline on which an episode is begun [m]; a longer one is only generated."""


def ground_files(folder: Path) -> dict[str, bytes]:
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


def read_ground(path: Path) -> str:
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


def cases(kind: str, folder: Path, originals: dict[str, bytes]) -> list[Case]:
    """Return one case for each mutation of each original."""

    def raw(name: str) -> list[Case]:
        data = originals[name]
        return [(m, lambda rng, f=f: f(data, rng), name, False) for m, f in BYTES.items()]

    if kind == "checkpoint":
        found = [case for name in ("best", "last") for case in raw(name)]
        for name in ("best", "last", "best", "last", "last"):
            data = originals[name]
            found += [
                ("document", lambda rng, d=data: signed.resigned(d, folder, rng), name, True),
                ("tensor", lambda rng, d=data: signed.resigned_tensors(d, folder, rng), name, True),
            ]
        return found
    if kind == "onnx":
        whole = originals["onnx"]
        return [
            *raw("onnx"),
            *(("metadata", lambda rng: signed.resealed(whole, rng), "onnx", True),) * 4,
        ]
    mutations = {**BYTES, "number": number_at_the_start}
    return [
        (m, lambda rng, f=f, d=data: f(d, rng), name, True)
        for m, f in mutations.items()
        for name, data in originals.items()
    ]


class Fuzz:
    """The cases of one kind; each depends on its number alone."""

    def __init__(self, kind: str, seed: int, folder: Path) -> None:
        (folder / "run" / "checkpoints").mkdir(parents=True, exist_ok=True)
        make = folder / "made"
        make.mkdir(exist_ok=True)
        self._kind, self._seed, self._folder = kind, seed, folder
        self._originals = ground_files(make) if kind == "ground" else signed.files(make)
        self._cases = cases(kind, folder, self._originals)
        self._expected = {name: self._read(name, self._originals[name]) for name in self._names}

    @property
    def _names(self) -> list[str]:
        return sorted({name for _, _, name, _ in self._cases})

    def mutation(self, index: int) -> str:
        """Return the name of the mutation of a case."""
        return self._cases[index % len(self._cases)][0]

    def check(self, index: int) -> str:
        """Read a mutant; return whether it equals the original, or may or must not differ."""
        _, mutate, name, may_differ = self._cases[index % len(self._cases)]
        rng = np.random.default_rng([self._seed, KINDS.index(self._kind), index])
        found = self._read(name, mutate(rng))
        if found == self._expected[name]:
            return "equal"
        return "other" if may_differ else "silent"

    def _read(self, name: str, data: bytes) -> str:
        if self._kind == "ground":
            path = self._folder / name
            path.write_bytes(data)
            return read_ground(path)
        if self._kind == "onnx":
            path = self._folder / f"{name}.onnx"
            path.write_bytes(data)
            return signed.read_onnx(path)
        path = self._folder / "run" / "checkpoints" / f"{name}.safetensors"
        path.write_bytes(data)
        return signed.read_checkpoint(path)

    def run(self, count: int) -> Iterator[tuple[str, Verdict]]:
        """Yield the mutation and the verdict of each of ``count`` cases."""
        for index in range(count):
            yield self.mutation(index), self.verdict(index)

    def verdict(self, index: int) -> Verdict:
        """Return what reading a mutant has come to, within ``LIMIT`` and ``MEMORY``."""
        printed = io.StringIO()
        try:
            with _limited(), _strict(printed):
                result = self.check(index)
        except FlipperctlError as error:
            result, text = "refused", str(error)
            plain = text.replace("\n", "", 1).isprintable()
            if error.exit_code != 2 or not plain:
                return "traceback", f"exit code {error.exit_code}: {text!r}"
        except TimeoutError:
            return "hang", f"no verdict within {LIMIT:g} s"
        except (Exception, SystemExit):  # noqa: BLE001 - the fuzz looks for any other error
            return "traceback", traceback.format_exc()[-600:]
        else:
            text = ""
        return ("noise", printed.getvalue()) if printed.getvalue() else (result, text)


@contextmanager
def _limited() -> Iterator[None]:
    """Raise ``TimeoutError`` after ``LIMIT``, and ``MemoryError`` beyond ``MEMORY``."""

    def stop(*_: object) -> None:
        raise TimeoutError

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGALRM, stop)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, limits[1]))
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, limits)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _strict(printed: io.StringIO) -> Iterator[None]:
    """Raise warnings, and keep what is printed."""
    outputs = contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed)
    with warnings.catch_warnings(), outputs[0], outputs[1]:
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        yield


@contextmanager
def fuzz(kind: str, seed: int) -> Iterator[Fuzz]:
    """Yield a fuzz with its own temporary folder."""
    torch.set_num_threads(1)
    plugins.load()
    with tempfile.TemporaryDirectory() as folder:
        yield Fuzz(kind, seed, Path(folder))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the fuzz; return 1 if there was a violation, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.files", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="mutants of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", default=",".join(KINDS))
    options = parser.parse_args(arguments)
    faulthandler.enable()  # a crash ends the command
    counts: dict[tuple[str, str], Counter[str]] = {}
    bad = 0
    for kind in options.kind.split(","):
        with fuzz(kind, options.seed) as found:
            for index, (mutation, (verdict, words)) in enumerate(found.run(options.count)):
                counts.setdefault((kind, mutation), Counter())[verdict] += 1
                if verdict in BAD:
                    bad += 1
                    print(f"{kind} {index} {mutation}: {verdict}: {words}", file=sys.stderr)
    for key, found in counts.items():
        print(*key, *(f"{verdict} {number}" for verdict, number in found.items()), sep=", ")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
