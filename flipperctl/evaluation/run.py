"""Write the files of an evaluation, the most important first: numbers before pictures.

In: the plan and the result of an evaluation. Out: ``episodes.csv`` with a row per episode,
``summary.json``, tables, recorded failures and episodes, pictures and a film. A file that cannot be
written does not affect the earlier ones.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from flipperctl.checkpoint import recording
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.evaluation.best_known import with_best_known
from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.episode_record import EpisodeRecord
from flipperctl.evaluation.evaluate import Result, evaluate
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, RECORDED, Row
from flipperctl.evaluation.store import FOLDER, VIEW, EpisodeStore, FolderStore, write_view
from flipperctl.evaluation.views import engines
from flipperctl.evaluation.views import evaluation as view
from flipperctl.evaluation.views.summary import Document, compared
from flipperctl.files import check_output, write_bytes, write_csv, write_json
from flipperctl.policies.source import PolicySource
from flipperctl.results import result_folder
from flipperctl.session import command, interrupts
from flipperctl.show import latex

SUMMARY = "summary.json"
NAMES = ("episodes.csv", SUMMARY, "table.csv", "table.tex")
MOST_FAILURES = 20
"""Largest number of failures of a scene that are recorded [-]."""
_DIGITS = 4
"""Decimals of ``table.csv``."""


def run(
    plan: Plan,
    *,
    references: Sequence[PolicySource] = (),
    by: Sequence[tuple[str, ...]] = (),
    outputs: Mapping[str, Path | None],
    show: Callable[[Result, Document], None] = lambda result, document: None,
    progress: Progress = no_progress,
    planned: Callable[[int], None] = lambda episodes: None,
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[Result, Document]:
    """Evaluate a plan, show the results and write the outputs; return the results.

    ``references``: see ``evaluate``. ``by``: drawn numbers that make groups. ``outputs``: paths of
    ``folder``, ``film`` and ``record``. ``show`` is called with the results before they are
    written, so that a full disk does not lose them; ``tell`` with a line for each output.

    Raises:
        FlipperctlError: an output is wrong or could not be written, or a policy failed.
        InterruptedRunError: it was stopped.
    """
    with ExitStack() as stack:
        written = EvaluationFiles(plan, stack, **outputs, tell=tell)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        result = evaluate(
            plan,
            references=references,
            progress=progress,
            record=outputs.get("record") is not None,
            stop=stop,
            store=written.store,
            planned=planned,
        )
        if plan.engines and result.interruption is None:
            result = engines.explained(result)
        if plan.with_best_known:
            result = with_best_known(result, written.store)
        document = view.document(result, by)
        try:
            show(result, document)
        finally:  # files are written even if the pipe is closed
            written.write(result, document)
        written.draw(result, stop, progress)
    return result, document


class EvaluationFiles:
    """The outputs that the user named; each may be None."""

    def __init__(
        self,
        plan: Plan,
        stack: ExitStack,
        *,
        folder: Path | None = None,
        film: Path | None = None,
        record: Path | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Check the outputs, and lock the folder until the ``stack`` is closed.

        ``tell`` is called with a line for each output that was written. The folder gets a picture
        of each scene if there is one policy.

        Raises:
            RequestError: the film has several scenes, or the recording several observation layouts.
            OutputError: the folder cannot be written.
            RunHeldError: another process is writing results into it.
        """
        self._plan, self._tell = plan, tell
        self._film, self._record = film, record
        entries = plan.rows
        several = any(entry.label != entries[0].label for entry in entries)
        for option, file in (("--film", film), ("--record", record)):
            if file and several:
                raise RequestError(
                    f"{option} takes one policy, without further ones (--baseline none)"
                )
            if file and folder and file.resolve() == folder.resolve():
                raise RequestError(f"{option} {file} and --output are the same; a file is allowed")
        if film:
            _check_film(film, len(entries))
        if record:
            check_output(record, recording.KIND)
            recording.require_one_layout(record, [entry.config for entry in entries])
        self._pictures = picture_names([] if several else entries)
        self._folder = None
        self.store = EpisodeStore()
        """Episodes that are not played again: those below the folder, if there is one."""
        if folder is not None:
            names = [*NAMES, *self._pictures, "failure_*.json"]
            names += [] if (folder / FOLDER).is_dir() else [VIEW]
            self._folder = stack.enter_context(result_folder(folder, "eval", names, [VIEW]))
            self.store = FolderStore(folder / FOLDER, tell)

    def write(self, result: Result, document: Document) -> None:
        """Write tables and recorded episodes.

        Raises:
            FlipperctlError: one of them could not be written; the other one was.
        """
        steps = [lambda: self._write_tables(result, document), lambda: self._write_record(result)]
        _attempt(steps)

    def _write_tables(self, result: Result, document: Document) -> None:
        if self._folder is None:
            return
        later = [] if result.interruption else self._pictures
        records = list(failure_records(result))

        def write(part: Path) -> None:
            write_csv(part / "episodes.csv", list(episode_rows(result)))
            write_json(part / SUMMARY, document)
            write_csv(part / "table.csv", list(view.csv_rows(document, _DIGITS)))
            table = view.policies(document, self._plan.title)
            write_bytes(part / "table.tex", latex(table).encode())
            for name, record in records:
                write_json(part / name, record.model_dump(mode="json"))

        path = self._folder.path
        lost = replaced(path, document)
        self._folder.replace(write, later)
        write_view(path)
        self._tell(f"saved to {path}")
        if lost:
            self._tell(
                f"earlier tables with {lost} are replaced; those episodes stay in {path / FOLDER}, "
                "and their command writes the tables again"
            )
        if records:
            replay = command("replay", path / records[0][0])
            several = f"{len(records)} failures" if len(records) > 1 else "a failure"
            self._tell(f"recorded {several}; to play the first again: {replay}")
        for version, count in self.store.other_versions.items():
            self._tell(
                f"{path / FOLDER}: {count} of these files were played with {version}, not the "
                "version here; another --output plays them again"
            )

    def _write_record(self, result: Result) -> None:
        if self._record is None:
            return
        parts = [
            (one.entry.config, [row[RECORDED] for row in one.episodes if RECORDED in row])
            for one in result.rows
        ]
        labels = dict.fromkeys(one.entry.label for one in result.rows)
        recording.write(self._record, ", ".join(labels), parts)
        self._tell(f"wrote {self._record}")

    def draw(
        self,
        result: Result,
        stop: Callable[[], bool] = lambda: False,
        progress: Progress = no_progress,
    ) -> None:
        """Draw the pictures and the film, unless the evaluation was interrupted.

        Raises:
            InterruptedRunError: the evaluation or the drawing was interrupted.
            FlipperctlError: a policy failed on a scene, or a picture or the film could not be drawn
                or written.
        """
        if result.interruption is not None:
            raise InterruptedRunError(result.interruption.text)
        if (error := result.error()) is not None:
            raise error
        pictures, film = self._draw_scenes, self._draw_film
        _attempt([lambda: pictures(stop, progress), lambda: film(stop, progress)])

    def _draw_scenes(self, stop: Callable[[], bool], progress: Progress) -> None:
        if self._folder is None or not self._pictures:
            return
        from flipperctl.evaluation.pictures import draw_scenes

        files = [self._folder.path / name for name in self._pictures]
        draw_scenes(dict(zip(files, self._plan.rows, strict=True)), progress, stop)

    def _draw_film(self, stop: Callable[[], bool], progress: Progress) -> None:
        if self._film is None:
            return
        if stop():
            raise InterruptedRunError(f"interrupted: {self._film} is not drawn")
        from flipperctl.evaluation.pictures import film_scene

        film_scene(self._film, self._plan.rows[0], progress)
        self._tell(f"wrote {self._film}")


def episode_rows(result: Result) -> Iterator[Row]:
    """Yield a flat row per episode; in each scene the policy's precede its baselines'."""
    for one in result.played:
        entry = one.entry
        who = {"scene": entry.terrain, "controller": entry.row_label}
        conditions = {"conditions": entry.conditions.name, "conditions_hash": entry.conditions.hash}
        for row in one.episodes:
            own = {n: value for n, value in row.items() if n not in (DIGEST, RECORDED)}
            yield {**who, **own, **conditions, **entry.names}


def failure_records(result: Result) -> Iterator[tuple[str, EpisodeRecord]]:
    """Yield the name of a file and the record of each policy's first failures on each scene."""
    entries = result.plan.rows
    found = scene_names([(entry.terrain, entry.conditions) for entry in entries])
    names = {id(entry): name for entry, name in zip(entries, found, strict=True)}
    several = len({entry.label for entry in entries}) > 1
    for one in result.rows:
        if one.entry.stored:
            continue
        words = ["failure", names[id(one.entry)], *([one.entry.label] if several else [])]
        stem = "_".join(re.findall(r"\w+", " ".join(words)))
        for row in one.episodes.failed[:MOST_FAILURES]:
            record = EpisodeRecord.of(one.entry.config, one.entry.source, row)
            yield f"{stem}_{row['episode']}.json", record


def picture_names(entries: Sequence[Entry]) -> list[str]:
    """Return a file name per scene: its terrain, and its conditions if a terrain has several."""
    named = scene_names([(entry.terrain, entry.conditions) for entry in entries])
    return ["_".join(re.findall(r"\w+", name)) + ".png" for name in named]


def replaced(folder: Path, document: Document) -> str:
    """Return, in words, the rows of earlier tables in a folder that a result lacks; "" for none.

    A row of more episodes, or with a baseline that there is no longer, is lost, too.
    """
    try:
        earlier = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))["scenes"]
        rows = [row for scene in earlier for row in _rows_of(scene)]
        now = sorted((r for scene in document["scenes"] for r in _rows_of(scene)), key=_count)
        most = dict(now)
        lost = [(row, count) for row, count in rows if count > most.get(row, 0)]
    except (OSError, ValueError, LookupError, TypeError):
        return ""  # there are none
    first = [
        f"{who} on {terrain}, seed {seed}, {count} episodes"
        for (terrain, who, seed, _), count in lost[:1]
    ]
    return " and ".join([*first, *([f"{len(lost) - 1} more rows"] if len(lost) > 1 else [])])


def _count(row: tuple[Any, int]) -> int:
    return row[1]


def _rows_of(scene: Mapping[str, Any]) -> Iterator[tuple[tuple[str, str, int, str], int]]:
    """Yield what tells each policy of a scene in ``summary.json`` apart, and its episodes."""
    terrain, seed, sampled = scene["terrain"], scene["seed"], scene["conditions"]["hash"]
    for who in (scene["controller"], *(other["controller"] for other in compared(scene))):
        yield (terrain, who, seed, sampled), scene["episodes"]


def _check_film(path: Path, scenes: int) -> None:
    from flipperctl.figures.film import FILM

    if scenes != 1:
        raise RequestError(f"--film shows one scene; {scenes} are evaluated")
    check_output(path, FILM)


def _attempt(steps: Sequence[Callable[[], None]]) -> None:
    """Take every step, even if one fails; then raise the first error with the texts of all."""
    failed: list[FlipperctlError] = []
    for step in steps:
        try:
            step()
        except FlipperctlError as error:
            failed.append(error)
    if failed:
        text = "; ".join(str(error) for error in failed)
        raise type(failed[0])(text) from failed[0]
