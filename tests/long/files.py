"""Damages files by the thousand and counts the results of reading them with flipperctl.

    python -m tests.long.files --count 2000 --seed 1 --kind checkpoint,onnx,ground

A damaged file must be refused by one clear error, or be read as the original; a recording and a
file with a new checksum may also be read as something else. Everything else is a violation, for
which the exit code is 1.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from flipperctl import plugins
from tests.long import ground, signed
from tests.long.isolated import Verdict, run_isolated
from tests.long.mutations import BYTES, Rng, number_at_the_start

KINDS = ("checkpoint", "onnx", "ground")
VERDICTS = ("refused", "equal", "other", "silent", "traceback", "noise", "hang")
BAD = VERDICTS[3:]
Case = tuple[str, Callable[[Rng], bytes], str, bool]
"""Name of the mutation; the mutant; name of the original; whether it may be read as another."""


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
            ("disguised", lambda rng: signed.disguised(whole, rng), "onnx", False),
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
        self._originals = ground.files(make) if kind == "ground" else signed.files(make)
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
            return ground.read(path)
        if self._kind == "onnx":
            path = self._folder / f"{name}.onnx"
            path.write_bytes(data)
            return signed.read_onnx(path)
        path = self._folder / "run" / "checkpoints" / f"{name}.safetensors"
        path.write_bytes(data)
        return signed.read_checkpoint(path)

    def run(self, count: int) -> Iterator[tuple[str, Verdict]]:
        """Yield the mutation and the verdict of each of ``count`` cases."""
        for index, verdict in enumerate(run_isolated(count, self.check)):
            yield self.mutation(index), verdict


@contextmanager
def fuzz(kind: str, seed: int) -> Iterator[Fuzz]:
    """Yield a fuzz with its own temporary folder."""
    torch.set_num_threads(1)
    plugins.load()
    with tempfile.TemporaryDirectory() as folder:
        yield Fuzz(kind, seed, Path(folder))


def table(counts: dict[tuple[str, str], Counter[str]]) -> str:
    """Return a table with a row for each kind and mutation and a column for each verdict."""
    lines = [["kind", "mutation", "count", *VERDICTS]]
    for (kind, mutation), found in counts.items():
        numbers = [sum(found.values()), *(found[verdict] for verdict in VERDICTS)]
        lines.append([kind, mutation, *map(str, numbers)])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(text.ljust(w) if i < 2 else text.rjust(w) for i, (text, w) in enumerate(pairs))
        for pairs in (list(zip(line, widths, strict=True)) for line in lines)
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the fuzz; return 1 if there was a violation, else 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.files", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="mutants of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", default=",".join(KINDS))
    options = parser.parse_args(arguments)
    counts: dict[tuple[str, str], Counter[str]] = {}
    bad = 0
    for kind in options.kind.split(","):
        with fuzz(kind, options.seed) as found:
            for index, (mutation, (verdict, words)) in enumerate(found.run(options.count)):
                counts.setdefault((kind, mutation), Counter())[verdict] += 1
                if verdict in BAD:
                    bad += 1
                    print(f"{kind} {index} {mutation}: {verdict}: {words}", file=sys.stderr)
    print(table(counts))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
