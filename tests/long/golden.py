"""What a change of structure must keep: written before the change, compared after it.

    python -m tests.long.golden --write golden.json
    python -m tests.long.golden --compare golden.json --only episodes,export

``golden_cases.py`` has the commands of each part. Entries are their exit codes and documents, and
what the files hold that they leave: cells of tables, digests of episodes and tensors, metadata and
outputs of ONNX. What is refused is a test (``tests/cli/test_refusals.py``).

It knows only the command line and formats of files. Numbers are compared bit for bit. They depend
on the kind of CPU and on the versions of numpy and torch, so the file is not committed: write it on
the same machine, from the commit before the change. The exit code is 1 if an entry has changed or
is missing; new entries are only listed. An intended difference is named in the message of the
commit that makes it.
"""

import argparse
import csv
import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import onnxruntime
from safetensors import safe_open

from tests.long import golden_cases as cases

ROOT = Path(__file__).parents[2]
AT_ONCE = 2
"""Commands that run at the same time."""
SHOWN = 20
"""Differences of each kind that are printed."""
_MASKED = re.compile(r"(^|/)(seconds|usage|timing\.json|versions|flipperctl\.package_version)(/|$)")
"""Entries that differ between equal runs, or between versions."""

Entries = dict[str, Any]


def run(jobs: Mapping[str, str], folder: Path) -> Entries:
    """Run commands in ``folder``; return their exit codes, and documents or errors."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}

    def entries(name: str) -> Entries:
        command = f"{sys.executable} -m flipperctl {jobs[name]}"
        done = subprocess.run(
            command, shell=True, cwd=folder, env=environment, capture_output=True, text=True
        )
        found = {f"{name}/exit code": done.returncode}
        if done.returncode:
            return found | {f"{name}/error": done.stderr}
        return found | (dict(flat(json.loads(done.stdout), name)) if "--json" in command else {})

    with ThreadPoolExecutor(AT_ONCE) as pool:
        return {key: value for part in pool.map(entries, jobs) for key, value in part.items()}


def flat(value: object, path: str) -> Iterator[tuple[str, object]]:
    """Yield the numbers and texts of nested dicts and lists, each with its path."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        if not value:
            yield path, value
        for key, inner in items:
            yield from flat(inner, f"{path}/{key}")
    elif not _MASKED.search(path):
        yield path, value


def digest(data: bytes) -> str:
    """Return the beginning of a SHA-256."""
    return hashlib.sha256(data).hexdigest()[:24]


# What a file holds, by its suffix


def table(file: Path, name: str) -> Entries:
    """Return the cells of a CSV file that are not empty."""
    with file.open(newline="") as text:
        rows = [{key: cell for key, cell in row.items() if cell} for row in csv.DictReader(text)]
    return dict(flat(rows, name))


def document(file: Path, name: str) -> Entries:
    """Return the entries of a JSON file."""
    return dict(flat(json.loads(file.read_text()), name))


def stored(file: Path, name: str) -> Entries:
    """Return the digests of the poses of stored episodes."""
    header, *rows = map(json.loads, file.read_text().splitlines())
    cell = f"{name.partition('/cells/')[0]}/{header['cell']}"
    return {f"{cell}/{row['seed']}": row["digest"] for row in rows if "digest" in row}


def weights(file: Path, name: str) -> Entries:
    """Return the digest of each tensor, of all of them without names, and the metadata."""
    found: Entries = {}
    with safe_open(file, "np") as opened:
        for key in opened.keys():  # noqa: SIM118 (it is no dict)
            tensor = opened.get_tensor(key)
            kind = f"{tensor.dtype} {'×'.join(map(str, tensor.shape))}"
            found[f"{name}/tensor {key}"] = f"{kind} {digest(tensor.tobytes())}"
        metadata = opened.metadata() or {}
    found[f"{name}/any names"] = digest("".join(sorted(found.values())).encode())
    return found | dict(flat({key: _parsed(text) for key, text in metadata.items()}, name))


def onnx(file: Path, name: str) -> Entries:
    """Return the metadata of an exported policy, and its outputs on random observations."""
    session = onnxruntime.InferenceSession(file)
    rng = np.random.default_rng(5)
    observations = {
        part.name: rng.normal(0, 0.3, [n if isinstance(n, int) else 16 for n in part.shape])
        for part in session.get_inputs()
    }
    outputs = session.run(None, {k: v.astype(np.float32) for k, v in observations.items()})
    names = [part.name for part in session.get_outputs()]
    metadata = session.get_modelmeta().custom_metadata_map
    parts = {
        "metadata": {key: _parsed(text) for key, text in metadata.items()},
        "outputs": {k: v.astype(float).tolist() for k, v in zip(names, outputs, strict=True)},
    }
    return dict(flat(parts, name))


def scene(file: Path, name: str) -> Entries:
    """Return the digest of an exported scene."""
    return {name: digest(file.read_bytes())}


def _parsed(text: str) -> object:
    return json.loads(text) if text[:1] in ("{", "[") else text


READ = {
    ".csv": table,
    ".json": document,
    ".jsonl": stored,
    ".safetensors": weights,
    ".onnx": onnx,
    ".xml": scene,
    ".urdf": scene,
}
"""Suffix → what a file of it holds."""


def measure(part: str) -> Entries:
    """Run the commands of a part in a folder of its own; return their entries and its files'."""
    with TemporaryDirectory(prefix="golden-") as name:
        folder, found = Path(name).resolve(), Entries()
        for file, text in cases.FILES.items():
            (folder / file).write_text(text)
        for batch in cases.PARTS[part]:
            found |= run(batch, folder)
        for file in sorted(folder.rglob("*")):
            if file.suffix in READ:
                found |= READ[file.suffix](file, str(file.relative_to(folder)))
    if failed := {key for key, value in found.items() if key.endswith("/exit code") and value}:
        print(f"{part}: failed: {sorted(failed)}", file=sys.stderr)
    entries: Entries = json.loads(json.dumps(found).replace(str(folder), "FOLDER"))
    return entries


def compare(part: str, before: Entries, after: Entries) -> bool:
    """Print what differs; return whether an entry has changed or is missing."""
    both = before.keys() & after.keys()
    kinds = {
        "changed": [key for key in before if key in both and repr(before[key]) != repr(after[key])],
        "missing": [key for key in before if key not in both],
        "new": [key for key in after if key not in both],
    }
    counts = ", ".join(f"{len(keys)} {kind}" for kind, keys in kinds.items())
    print(f"{part}: {len(both) - len(kinds['changed'])} equal, {counts}")
    for kind, keys in kinds.items():
        for key in keys[:SHOWN]:
            texts = (json.dumps(entries[key]) for entries in (before, after) if key in entries)
            print(f"  {kind} {key}: {' → '.join(texts)}")
        if len(keys) > SHOWN:
            last = Counter(key.rpartition("/")[2] for key in keys).most_common(SHOWN)
            print(f"  {kind}, by last name: {', '.join(f'{name} {n}' for name, n in last)}")
    return bool(kinds["changed"] or kinds["missing"])


def machine() -> dict[str, str]:
    """Return what floating-point results depend on."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", info.read_text()) if info.exists() else None
    packages = {name: version(name) for name in ("numpy", "torch", "pymunk", "mujoco")}
    return {"cpu": model[1] if model else platform.processor(), **packages}


def main(arguments: list[str] | None = None) -> int:
    """Parse the command line; write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    doing = parser.add_mutually_exclusive_group(required=True)
    doing.add_argument("--write", type=Path, metavar="FILE")
    doing.add_argument("--compare", type=Path, metavar="FILE")
    parser.add_argument("--only", default=",".join(cases.PARTS), help="parts, separated by commas")
    options = parser.parse_args(arguments)
    names = options.only.split(",")
    if unknown := set(names) - cases.PARTS.keys():
        parser.error(f"--only: {', '.join(cases.PARTS)} are allowed; the value has {unknown}")
    if options.write:
        written = {"machine": machine(), "parts": {name: measure(name) for name in names}}
        options.write.write_text(json.dumps(written, indent=0, ensure_ascii=False))
        return 0
    before = json.loads(options.compare.read_text())
    if before["machine"] != machine():
        print(f"written on another machine: {before['machine']}; here {machine()}")
    differs = [compare(name, before["parts"].get(name, {}), measure(name)) for name in names]
    return int(any(differs))


if __name__ == "__main__":
    sys.exit(main())
