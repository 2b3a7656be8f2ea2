"""The store of episodes, which are played once: in memory, or in a folder that lasts.

In: finished episodes of a policy under a configuration, block by block. Out: the same rows, bit
for bit. The key of a block is equal exactly where results are equal, whatever plays them. A block's
file is written whole: JSON lines, a header and then a record for each episode.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import flipperctl
from flipperctl.config import EvalConfig, to_dict
from flipperctl.config.identity import all_files_read, content_digest, foreign_sources
from flipperctl.env.metrics import CORE, measures
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.rows import DIGEST, RECORDED, Row
from flipperctl.plugging.guard import OWN
from flipperctl.policies.identity import PolicyIdentity
from flipperctl.rollout.statement import package_files
from flipperctl.sim.versions import engine_versions
from flipperctl.text.files import make_folder, write_bytes, write_chunks, write_json

FORMAT = 1  # number of the format of a block's file
FOLDER, VIEW = "cells", "cells.csv"
"""The folder of the blocks within the folder of results, and the table of all their episodes."""
_BLOCK, _FAILED = ".jsonl", ".failed.json"
_VIEWED = ("controller", "training_seed", "scene", "conditions", "conditions_hash", "engine")
"""Entries of a block's header that the table of all episodes repeats."""
_TOLD = {"controller", "conditions_hash", "policy", "training_seed"}
"""Entries that the header of every block has, for readers."""
_LONG, _SHORT = 16, 8  # digits of the hashes within a key
_LIBRARIES = ("numpy", "torch")
_GIT_PATIENCE = 5.0  # [s]
_DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError)
"""What reading a damaged file may raise."""


@dataclass(frozen=True)
class StoreKey:
    """What the episodes of one policy under one configuration and seed depend on."""

    policy: PolicyIdentity
    ground: str
    """What is equal for all policies on equal episodes; see ``ground``."""
    scoring: str
    """SHA-256 of what else a result depends on: rewards, measures and the observation layout."""
    config: EvalConfig = field(compare=False, repr=False)

    @classmethod
    def of(cls, config: EvalConfig, policy: PolicyIdentity) -> StoreKey:
        """Return the key of a policy's episodes under a configuration."""
        return cls(policy, ground(config), _digest(_scoring(config)), config)

    @property
    def text(self) -> str:
        """The name of a block without its range of episodes."""
        training = "x" if self.policy.training_seed is None else self.policy.training_seed
        return f"{self.policy.digest[:_LONG]}.{training}.{self.ground}.{self.scoring[:_SHORT]}"

    def header(self, first: int, last: int) -> dict[str, Any]:
        """Return the header of the block with the episodes from ``first`` to ``last``."""
        conditions = Conditions.of(self.config)
        return {
            "record": "cell",
            "format": FORMAT,
            "cell": block_name(self.text, first, last),
            "policy": self.policy.digest,
            "training_seed": self.policy.training_seed,
            "training": self.policy.training,
            "controller": self.policy.label,
            "scene": self.config.terrain.plugin_name,
            "conditions": conditions.name,
            "conditions_hash": conditions.hash,
            "engine": self.config.sim.plugin_name,
            "evaluation_seed": self.config.eval.seed,
            "first": first,
            "last": last,
            "settings": {**conditions.settings, **_scoring(self.config)},
            "versions": versions_here(self.config),
            "commit": commit(),
        }


def versions_here(config: EvalConfig) -> dict[str, str]:
    """Return the versions of the packages on which the episodes depend if played here, by name.

    In a checkout, whose code changes within a version, ``code`` is a hash of it.
    """
    return {
        "flipperctl": flipperctl.__version__,
        **({} if (code := code_digest()) is None else {"code": code}),
        **{name: version(name) for name in _LIBRARIES},
        **engine_versions(config.sim),
    }


def ground(config: EvalConfig) -> str:
    """Return the part of a key that is equal for all policies on equal episodes.

    It has a hash of terrain, robot, physics, sensing, start and randomisation, and the seed of the
    evaluation.
    """
    plugged = [config.terrain, config.sim, config.perception]
    digest = _digest([Conditions.of(config).settings, foreign_sources(plugged)])
    return f"{digest[:_LONG]}.{config.eval.seed}"


def block_name(key: str, first: int, last: int) -> str:
    """Return the name of the block with the episodes from ``first`` to ``last``."""
    return f"{key}.{first:06d}-{last:06d}"


def blocks(indices: Sequence[int], size: int) -> Iterator[list[int]]:
    """Yield the blocks of ascending indices: runs without a gap that pass no multiple of ``size``.

    The ends depend on the indices alone, so that any number of processes writes equal files.
    """
    block: list[int] = []
    for index in indices:
        if block and (index != block[-1] + 1 or index % size == 0):
            yield block
            block = []
        block.append(index)
    if block:
        yield block


def _checkout() -> Path | None:
    """Return the root of the checkout that runs; None for an installed package."""
    root = Path(flipperctl.__file__).parents[1]
    return root if (root / ".git").exists() else None


@cache
def code_digest() -> str | None:
    """Return a hash of the code of the checkout that runs; None for an installed package."""
    if _checkout() is None:
        return None
    files = [item for package in OWN for item in package_files(package).items()]
    return _digest([digest for name, digest in files if name.endswith(".py")])[:_SHORT]


@cache
def commit() -> str | None:
    """Return the commit of the checkout that runs; None for an installed package."""
    if (root := _checkout()) is None:
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        # A checkout without git, or a slow one, has no commit to name.
        done = subprocess.run(  # noqa: S603 - all words are our own
            command, capture_output=True, text=True, timeout=_GIT_PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def _scoring(config: EvalConfig) -> dict[str, Any]:
    """Return what results depend on besides the conditions, as plain data."""
    whole = to_dict(config.environment())
    by_name = measures()
    files = all_files_read([*config.rewards.values(), *by_name.values()])
    return {
        **({"files": [content_digest(file) for file in files]} if files else {}),
        "rewards": whole["rewards"],
        "layout": to_dict(config.perception.layout),
        "measures": {name: to_dict(measure) for name, measure in by_name.items()},
        "sources": foreign_sources([*config.rewards.values(), *by_name.values()]),
    }


def _digest(document: object) -> str:
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class EpisodeStore:
    """Episodes by key and index, in memory."""

    def __init__(self) -> None:
        self.other_versions: Counter[str] = Counter()
        """Number of blocks that were read and that were played with another version of a package,
        by the package and that version."""
        self._rows: dict[str, dict[int, Row]] = {}

    def find(self, key: StoreKey) -> dict[int, Row]:
        """Return the stored episodes of a key by index."""
        return dict(self._rows.get(key.text, {}))

    def add(self, key: StoreKey, block: Sequence[Row]) -> None:
        """Keep the episodes of a block, whose indices have no gap."""
        rows = self._rows.setdefault(key.text, {})
        for row in block:
            rows.setdefault(row["episode"], {n: v for n, v in row.items() if n != RECORDED})

    def fail(self, key: StoreKey, first: int, last: int, error: FlipperctlError) -> None:
        """Note that a block could not be played; in memory, nothing is kept of it."""


class FolderStore(EpisodeStore):
    """Blocks as files in a folder; earlier ones are read when they are asked for."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda text: None) -> None:
        """``tell`` is called with a line about blocks that are damaged."""
        super().__init__()
        self._folder, self._tell = make_folder(folder), tell
        self._files: dict[str, list[Path]] = {}
        self._read: set[str] = set()
        for file in sorted(folder.glob(f"*{_BLOCK}")):
            key = file.name.removesuffix(_BLOCK).rpartition(".")[0]
            self._files.setdefault(key, []).append(file)

    def find(self, key: StoreKey) -> dict[int, Row]:
        """Return the stored episodes of a key by index; damaged files are told and left out."""
        if key.text not in self._read:
            self._read.add(key.text)
            damaged: list[Path] = []
            for file in self._files.get(key.text, ()):
                if (block := read_block(file)) is None:
                    damaged.append(file)
                    continue
                header, rows = block
                self.count_versions(header, versions_here(key.config))
                super().add(key, rows)
            # A damaged file goes once other blocks have its episodes.
            for file in damaged:
                if self._holds(key, file):  # other blocks have its episodes
                    file.unlink(missing_ok=True)
                    self._files[key.text].remove(file)
                else:
                    self._tell(f"{file} is damaged; its episodes are played again")
        return super().find(key)

    def _holds(self, key: StoreKey, file: Path) -> bool:
        """Return whether all episodes are stored that a block's file has by its name."""
        first, _, last = file.name.removesuffix(_BLOCK).rpartition(".")[2].partition("-")
        if not (first.isdecimal() and last.isdecimal()):
            return False
        return super().find(key).keys() >= set(range(int(first), int(last) + 1))

    def add(self, key: StoreKey, block: Sequence[Row]) -> None:
        """Write the block's file; see ``EpisodeStore.add``."""
        first, last = block[0]["episode"], block[-1]["episode"]
        name = block_name(key.text, first, last)
        # A header, then a line for each episode, whose digest comes first
        lines = [key.header(first, last)]
        for row in block:
            digest = {DIGEST: row[DIGEST]} if DIGEST in row else {}
            rest = {n: value for n, value in row.items() if n not in (DIGEST, RECORDED)}
            lines.append({"record": "episode", "cell": name, **digest, **rest})
        texts = (
            json.dumps(line, separators=(",", ":"), default=lambda number: number.item()) + "\n"
            for line in lines
        )
        # The block is written whole; a failure noted earlier is over.
        file = self._folder / f"{name}{_BLOCK}"
        write_bytes(file, "".join(texts).encode())
        self._files.setdefault(key.text, []).append(file)
        for failed in self._folder.glob(f"{key.text}.{first:06d}-*{_FAILED}"):
            failed.unlink(missing_ok=True)
        super().add(key, block)

    def fail(self, key: StoreKey, first: int, last: int, error: FlipperctlError) -> None:
        """Write a file that says why a block could not be played, until it is played."""
        why = {"record": "failure", "error": type(error).__name__, "text": str(error)}
        document = key.header(first, last) | why
        write_json(self._folder / f"{document['cell']}{_FAILED}", document)

    def stored_on(self, ground: str) -> Iterator[tuple[list[dict[str, Any]], dict[int, Row]]]:
        """Yield the headers and the episodes by index of each stored policy on a ``ground``."""
        for key, files in list(self._files.items()):
            blocks = [block for file in files if (block := read_block(file))]
            if f".{ground}." in key and blocks:
                rows = {row["episode"]: row for _, part in blocks for row in part}
                yield [header for header, _ in blocks], rows

    def count_versions(self, header: Mapping[str, Any], here: Mapping[str, str]) -> None:
        """Count a block that was played with other versions than those ``here``."""
        for package, played_with in header["versions"].items():
            if here.get(package) != played_with:
                self.other_versions[f"{package} {played_with}"] += 1


def headers(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the header of each block in a folder; damaged files are left out."""
    for file in sorted(folder.glob(f"*{_BLOCK}")):
        try:
            with file.open() as lines:
                header = json.loads(lines.readline())
            if header.keys() >= _TOLD:
                yield header
        except _DAMAGE:
            continue  # an evaluation says so


def played_policies(folder: Path) -> dict[tuple[str, str], set[str]]:
    """Return the digests of the policies of a folder's blocks, by label and conditions' hash."""
    policies: dict[tuple[str, str], set[str]] = {}
    for header in headers(folder):
        key = header["controller"], header["conditions_hash"]
        policies.setdefault(key, set()).add(header["policy"])
    return policies


def read_block(file: Path) -> tuple[dict[str, Any], list[Row]] | None:
    """Return the header and the episodes of a block's file; None if it is damaged."""
    try:
        header, *records = (json.loads(line) for line in file.read_text().splitlines())
        indices = list(range(header["first"], header["last"] + 1))
        # The episodes are those that header and name say, so that no cut file counts.
        whole = [row["episode"] for row in records] == indices and header["format"] == FORMAT
        if not whole or f"{header['cell']}{_BLOCK}" != file.name:
            return None
        rows = []
        for record in records:
            if not {"seed", "outcome", "terrain", *CORE, "return"} <= record.keys():
                return None  # it is no episode
            digest = {DIGEST: record.pop(DIGEST)} if DIGEST in record else {}
            rows.append({n: v for n, v in record.items() if n not in ("record", "cell")} | digest)
        return header, rows
    except _DAMAGE:
        return None


def write_view(results: Path) -> None:
    """Write the table of all stored episodes below a folder of results, if there are any.

    The blocks are read one after the other, so that their number needs no memory.
    """
    files = sorted((results / FOLDER).glob(f"*{_BLOCK}"))
    columns = dict.fromkeys(name for file in files for row in _viewed(file) for name in row)

    # Block by block, so that the table may be larger than the memory
    def chunks() -> Iterator[bytes]:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(columns))
        writer.writeheader()
        for file in files:
            writer.writerows(_viewed(file))
            yield text.getvalue().encode()
            text.seek(0)
            text.truncate()

    if files:
        write_chunks(results / VIEW, chunks())


def _viewed(file: Path) -> Iterator[Row]:
    """Yield the rows of a block in the table of all episodes; none if it is damaged."""
    if (block := read_block(file)) is not None:
        header, rows = block
        who = {"cell": header["cell"], **{name: header[name] for name in _VIEWED}}
        for row in rows:
            yield who | {n: value for n, value in row.items() if n != DIGEST}
