"""Stores of episodes, which are played once: in memory, or in a folder that outlives the process.

In: finished episodes of a series, cell by cell. Out: the same episodes, bit for bit. A cell's file
is written whole: JSON lines, a header and then a record for each episode.
"""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.cells import FORMAT, Series, cell_name
from flipperctl.evaluation.episode import EpisodeResult
from flipperctl.files import make_folder, write_bytes, write_chunks, write_json

FOLDER, VIEW = "cells", "cells.csv"
"""The folder of the cells within that of the results, and the table of all their episodes."""
_CELL, _FAILED = ".jsonl", ".failed.json"
_VIEWED = ("controller", "training_seed", "scene", "conditions", "conditions_hash", "engine")
"""Entries of a cell's header that the table of all episodes repeats."""


class EpisodeStore:
    """Episodes by series and index, in memory."""

    def __init__(self) -> None:
        self.other_versions: Counter[str] = Counter()
        """Number of cells that were read and that were played with another version of a package,
        by the package and that version."""
        self._episodes: dict[str, dict[int, EpisodeResult]] = {}

    def find(self, series: Series) -> dict[int, EpisodeResult]:
        """Return the stored episodes of a series by index."""
        return dict(self._episodes.get(series.key, {}))

    def add(self, series: Series, cell: Sequence[EpisodeResult]) -> None:
        """Keep the episodes of a cell, whose indices have no gap.

        Raises:
            OutputError: the cell cannot be written.
            WriteError: writing it failed half way.
        """
        kept = self._episodes.setdefault(series.key, {})
        for episode in cell:
            kept.setdefault(episode.episode, replace(episode, recorded=None))

    def fail(self, series: Series, first: int, last: int, error: FlipperctlError) -> None:
        """Note that a cell could not be played; in memory, nothing is kept of it."""


class CellFolder(EpisodeStore):
    """Cells as files in a folder; those that lie there already are read when they are asked for."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda text: None) -> None:
        """``tell`` is called with a line about cells that are damaged, or of another version.

        Raises:
            OutputError: the folder cannot be created or written.
        """
        super().__init__()
        self._folder, self._tell = make_folder(folder), tell
        self._files: dict[str, list[Path]] = {}
        self._read: set[str] = set()
        for file in sorted(folder.glob(f"*{_CELL}")):
            self._files.setdefault(file.name.removesuffix(_CELL).rpartition(".")[0], []).append(
                file
            )

    def find(self, series: Series) -> dict[int, EpisodeResult]:
        """Return the stored episodes of a series by index; damaged files are told and left out."""
        if series.key not in self._read:
            self._read.add(series.key)
            here = series.versions
            damaged: list[Path] = []
            for file in self._files.get(series.key, ()):
                if (cell := read_cell(file)) is None:
                    damaged.append(file)
                    continue
                header, episodes = cell
                self.count_versions(header, here)
                super().add(series, episodes)
            for file in damaged:
                if self._holds(series, file):  # other cells have its episodes
                    file.unlink(missing_ok=True)
                    self._files[series.key].remove(file)
                else:
                    self._tell(f"{file} is damaged; its episodes are played again")
        return super().find(series)

    def _holds(self, series: Series, file: Path) -> bool:
        """Return whether all episodes are stored that a cell's file has by its name."""
        first, _, last = file.name.removesuffix(_CELL).rpartition(".")[2].partition("-")
        if not (first.isdecimal() and last.isdecimal()):
            return False
        return super().find(series).keys() >= set(range(int(first), int(last) + 1))

    def add(self, series: Series, cell: Sequence[EpisodeResult]) -> None:
        """Write the cell's file; see ``EpisodeStore.add``."""
        first, last = cell[0].episode, cell[-1].episode
        name = cell_name(series.key, first, last)
        lines = [series.header(first, last)]
        lines += [_record(name, episode) for episode in cell]
        text = "".join(
            json.dumps(line, separators=(",", ":"), default=_plain) + "\n" for line in lines
        )
        file = self._folder / f"{name}{_CELL}"
        write_bytes(file, text.encode())
        self._files.setdefault(series.key, []).append(file)
        for failed in self._folder.glob(f"{series.key}.{first:06d}-*{_FAILED}"):
            failed.unlink(missing_ok=True)
        super().add(series, cell)

    def fail(self, series: Series, first: int, last: int, error: FlipperctlError) -> None:
        """Write a file that says why a cell could not be played, until it is played."""
        document = series.header(first, last) | {
            "record": "failure",
            "error": type(error).__name__,
            "text": str(error),
        }
        write_json(self._folder / f"{document['cell']}{_FAILED}", document)

    def stored_on(
        self, ground: str
    ) -> Iterator[tuple[list[dict[str, Any]], dict[int, EpisodeResult]]]:
        """Yield the headers and the episodes of each stored policy on a ``cells.ground``."""
        for key in list(self._files):
            if f".{ground}." in key:
                cells = [cell for file in self._files[key] if (cell := read_cell(file))]
                if cells:
                    headers = [header for header, _ in cells]
                    yield headers, {e.episode: e for _, episodes in cells for e in episodes}

    def count_versions(self, header: Mapping[str, Any], here: Mapping[str, str]) -> None:
        """Count a cell that was played with other versions than those ``here``."""
        for package, version in header["versions"].items():
            if here.get(package) != version:
                self.other_versions[f"{package} {version}"] += 1


@dataclass(frozen=True)
class PlayedPolicy:
    """Whose cells lie in a folder, under a label."""

    digest: str
    """SHA-256 of its weights or settings."""
    training_seed: int | None
    """Seed of its training; None for a rule."""
    training: Mapping[str, Any] | None = field(default=None, compare=False)
    """Settings in which the trainings of its method agree; None for a rule or an exported file, and
    in cells of version 0.2."""


def played_policies(folder: Path) -> dict[tuple[str, str], set[PlayedPolicy]]:
    """Return the policies whose cells lie in a folder, by label and hash of the conditions."""
    found: dict[tuple[str, str], set[PlayedPolicy]] = {}
    for file in sorted(folder.glob(f"*{_CELL}")):
        try:
            with file.open() as lines:
                header = json.loads(lines.readline())
            key = header["controller"], header["conditions_hash"]
            policy = PlayedPolicy(header["policy"], header["training_seed"], header.get("training"))
        except (OSError, ValueError, LookupError, TypeError):
            continue  # it is damaged; an evaluation says so
        found.setdefault(key, set()).add(policy)
    return found


def read_cell(file: Path) -> tuple[dict[str, Any], list[EpisodeResult]] | None:
    """Return the header and the episodes of a cell's file; None if it is damaged."""
    try:
        header, rows = _read_records(file)
        return header, list(map(_episode, rows))
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _read_records(file: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the header and the records of a cell's file, or raise an error if it is damaged."""
    header, *rows = (json.loads(line) for line in file.read_text().splitlines())
    indices = list(range(header["first"], header["last"] + 1))
    whole = [row["episode"] for row in rows] == indices and header["format"] == FORMAT
    if not whole or f"{header['cell']}{_CELL}" != file.name:
        raise ValueError(f"{file} is not the cell that its name says")
    return header, rows


def write_view(results: Path) -> None:
    """Write the table of all episodes of all cells below a folder of results, if there are any.

    The cells are read one after the other, so that their number needs no memory.

    Raises:
        OutputError: the table cannot be written.
        WriteError: writing failed half way; an earlier table, if any, is kept.
    """
    files = sorted((results / FOLDER).glob(f"*{_CELL}"))
    if not files:
        return
    columns: dict[str, None] = {}
    for file in files:
        for row in _viewed(file):
            columns |= dict.fromkeys(row)
    write_chunks(results / VIEW, _csv_lines(files, list(columns)))


def _csv_lines(files: Sequence[Path], columns: Sequence[str]) -> Iterator[bytes]:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    for file in files:
        writer.writerows(_viewed(file))
        yield text.getvalue().encode()
        text.seek(0)
        text.truncate()


def _viewed(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a cell in the table of all episodes; none if it is damaged."""
    try:
        header, rows = _read_records(file)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return
    who = {"cell": header["cell"], **{name: header[name] for name in _VIEWED}}
    for row in rows:
        yield who | {n: value for n, value in row.items() if n not in ("record", "digest")}


def _record(cell: str, episode: EpisodeResult) -> dict[str, Any]:
    """Return the record of an episode in a cell."""
    own = {} if episode.digest is None else {"digest": episode.digest}
    return {"record": "episode", "cell": cell, **own, **episode.row()}


def _episode(row: dict[str, Any]) -> EpisodeResult:
    """Return the episode of a record, without what describes the record."""
    rest = {k: v for k, v in row.items() if k not in ("record", "cell", "episode", "digest")}
    return EpisodeResult.of(row["episode"], rest, row.get("digest"))


def _plain(value: Any) -> Any:
    """Return a number of numpy as Python's."""
    return value.item()
