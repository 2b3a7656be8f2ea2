"""Play a plan, and write the files of its result, numbers before pictures.

In: the plan of an evaluation. Out: ``episodes.csv`` with a row per episode,
``summary.json``, tables, recorded failures and episodes, pictures and a film. A file that cannot be
written does not affect the earlier ones.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from flipperctl.checkpoint import recording
from flipperctl.checkpoint.results import result_folder
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.evaluation import replay
from flipperctl.evaluation.best_known import with_best_known
from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.engines import explained
from flipperctl.evaluation.evaluate import Result, evaluate
from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.rows import DIGEST, RECORDED, Row
from flipperctl.evaluation.store import (
    FOLDER,
    VIEW,
    EpisodeStore,
    FolderStore,
    write_view,
)
from flipperctl.evaluation.stored import FILE as EPISODES
from flipperctl.evaluation.stored import SUMMARY, read_document
from flipperctl.policies.source import PolicySource
from flipperctl.process.session import command, interrupts
from flipperctl.requests import traces
from flipperctl.requests.filming import Filming
from flipperctl.rollout.trace import FILE as TRACES
from flipperctl.text.files import check_output, write_bytes, write_csv, write_json
from flipperctl.text.messages import counted
from flipperctl.text.show import latex
from flipperctl.views import evaluation as view
from flipperctl.views import report
from flipperctl.views.summary import Document, compared

NAMES = (EPISODES, SUMMARY, "table.csv", "table.tex", TRACES)
MOST_FAILURES = 20  # largest number of failures of a scene that are recorded [-]
_DIGITS = 4  # decimals of ``table.csv``


def run(
    plan: Plan,
    *,
    references: Sequence[PolicySource] = (),
    by: Sequence[tuple[str, ...]] = (),
    outputs: Mapping[str, Path | None],
    filming: Filming | None = None,
    show: Callable[[Result, Document], None] = lambda result, document: None,
    progress: Progress = no_progress,
    planned: Callable[[int], None] = lambda episodes: None,
    tell: Callable[[str], None] = lambda text: None,
    typed: str = "",
) -> tuple[Result, Document]:
    """Evaluate a plan, show the results and write the outputs; return the results.

    ``references``: see ``evaluate``. ``by``: drawn numbers that make groups. ``outputs``: paths of
    ``folder`` and ``record``. ``show`` is called with the results before they are
    written, so that a full disk does not lose them; ``tell`` with a line for each output.
    ``typed``: the command, for the report.
    """
    with ExitStack() as stack:
        # Outputs are checked and locked before anything is played.
        written = _Files(plan, stack, tell, filming, **outputs)
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
        # What follows from the episodes, before anything is shown
        if plan.engines and result.interruption is None:
            result = explained(result)
        if plan.has_baselines:
            result = with_best_known(result, written.store)
        document = view.document(result, by) | ({"command": typed} if typed else {})
        try:
            show(result, document)
        finally:  # files are written even if the pipe is closed
            written.write(result, document)
        written.draw(result, stop, progress)
    return result, document


class _Files:
    """The outputs that the user named; each may be None."""

    def __init__(
        self,
        plan: Plan,
        stack: ExitStack,
        tell: Callable[[str], None],
        filming: Filming | None = None,
        *,
        folder: Path | None = None,
        record: Path | None = None,
    ) -> None:
        """Check the outputs, and lock the folder until the ``stack`` is closed.

        The folder gets a picture of each scene if there is one policy.
        """
        self._plan, self._tell = plan, tell
        self._filming, self._record = filming, record
        # Refuse what contradicts, before the folder is touched.
        entries = plan.rows
        several = any(entry.label != entries[0].label for entry in entries)
        film = filming.path if filming else None
        if filming:
            filming.check(plan)
        if record and several:
            raise RequestError("--record takes one policy, without further ones (--baseline none)")
        for option, file in (("--film", film), ("--record", record)):
            if file and folder and file.resolve() == folder.resolve():
                raise RequestError(f"{option} {file} and --output are the same; a file is allowed")
        if record:
            check_output(record, recording.KIND)
            recording.require_one_layout(record, [entry.config for entry in entries])
        # File names in the folder, and those that only a complete evaluation writes
        self._pictures = picture_names([] if several else entries)
        self._later = [TRACES, *self._pictures]
        self._folder = None
        self.store = EpisodeStore()
        """Episodes that are not played again: those below the folder, if there is one."""
        # The folder belongs to this process until the end; its store remembers earlier episodes.
        if folder is not None:
            names = [*NAMES, *self._pictures, "failure_*.json"]
            names += [] if (folder / FOLDER).is_dir() else [VIEW]
            summed = [VIEW, report.FILE]
            if (folder / report.FILE).exists():
                check_output(folder / report.FILE, report.REPORT)
            self._folder = stack.enter_context(result_folder(folder, "eval", names, summed))
            self.store = FolderStore(folder / FOLDER, tell)

    def write(self, result: Result, document: Document) -> None:
        """Write tables and recorded episodes, each even if the other one cannot be written."""
        _attempt(lambda: self._write_tables(result, document), lambda: self._write_record(result))

    def _write_tables(self, result: Result, document: Document) -> None:
        if self._folder is None:
            return
        # Records are made before any file is written.
        path, records = self._folder.path, list(failure_records(result))
        self._traces = traces.Traces(path / TRACES, traces.choose(result, document), self._tell)

        def write(part: Path) -> None:
            write_csv(part / EPISODES, list(episode_rows(result)))
            write_json(part / SUMMARY, document)
            write_csv(part / "table.csv", list(view.csv_rows(document, _DIGITS)))
            table = view.policies(document, self._plan.title)
            write_bytes(part / "table.tex", latex(table).encode())
            for name, record in records:
                write_json(part / name, record.model_dump(mode="json"))
            self._traces.write(part / TRACES)

        # Files are replaced together; the report is of earlier ones, and follows later.
        lost = _lost_rows(path, document)
        self._folder.replace(write, [] if result.interruption else self._later)
        (path / report.FILE).unlink(missing_ok=True)  # until the new report is written
        write_view(path)
        self._tell(f"saved to {path}")
        if lost:
            self._tell(
                f"earlier tables with {lost} are replaced; those episodes stay in {path / FOLDER}, "
                "and their command writes the tables again"
            )
        # How to see the failures, and which stored episodes other versions played
        if records:
            again = command("replay", path / records[0][0])
            which = "the first" if len(records) > 1 else "it"
            self._tell(
                f"recorded {counted(len(records), 'failure')}; to play {which} again: {again}"
            )
        for version, count in self.store.other_versions.items():
            self._tell(
                f"{path / FOLDER}: {count} of these files were played with {version}, not the "
                "version here; another --output plays them again"
            )

    def _write_record(self, result: Result) -> None:
        if self._record is not None:
            parts = [
                (item.entry.config, [row[RECORDED] for row in item.episodes if RECORDED in row])
                for item in result.rows
            ]
            labels = dict.fromkeys(item.entry.label for item in result.rows)
            recording.write(self._record, ", ".join(labels), parts)
            self._tell(f"wrote {self._record}")

    def draw(self, result: Result, stop: Callable[[], bool], progress: Progress) -> None:
        """Trace chosen episodes, and draw the pictures and the film.

        Nothing of it if the evaluation was interrupted or failed.
        """
        if result.interruption is not None:
            raise InterruptedRunError(result.interruption.text)
        if (error := result.error()) is not None:
            raise error

        # A picture that fails must not prevent the others, nor the film.
        def pictures() -> None:
            if self._folder is not None:
                path, drawn = self._folder.path, zip(self._pictures, self._plan.rows, strict=False)
                _attempt(
                    lambda: self._traces.record(progress, stop),
                    *(partial(self._traces.draw, path / name, entry) for name, entry in drawn),
                    lambda: report.write(path, path / report.FILE),
                )
                self._tell(f"report: {path / report.FILE}")

        def film() -> None:
            if self._filming is not None:
                if stop():
                    raise InterruptedRunError(f"interrupted: {self._filming.path} is not drawn")
                self._filming.make(result, progress, self._tell)

        _attempt(pictures, film)


def episode_rows(result: Result) -> Iterator[Row]:
    """Yield a flat row per episode; in each scene the policy's precede its baselines'."""
    # A policy is called as on the screen; the label beside it is its file.
    labels = [item.entry.method or item.entry.label for item in result.played]
    called = short_names(list(dict.fromkeys(labels)))
    for item, label in zip(result.played, labels, strict=True):
        entry = item.entry
        who = {"scene": entry.terrain, "method": called[label], "controller": entry.row_label}
        policy = item.policy.columns if item.policy else {}
        conditions = {"conditions": entry.conditions.name, "conditions_hash": entry.conditions.hash}
        for row in item.episodes:
            numbers = {n: value for n, value in row.items() if n not in (DIGEST, RECORDED)}
            yield {**who, **numbers, **conditions, **policy, **entry.names}


def failure_records(result: Result) -> Iterator[tuple[str, replay.EpisodeRecord]]:
    """Yield the name of a file and the record of each policy's first failures on each scene."""
    entries = result.plan.rows
    scenes = dict(zip(map(id, entries), _scene_names(entries), strict=True))
    labels = list(dict.fromkeys(entry.label for entry in entries))
    policies = [Path(label.partition("/checkpoints/")[0]).stem for label in labels]
    for item in result.rows:
        if item.entry.stored:
            # Names of files say scene and policy, as far as there are several.
            continue
        words = ["failure", scenes[id(item.entry)]]
        if len(labels) > 1:  # a path's last part, and a number where it is not telling
            at = labels.index(item.entry.label)
            words += [policies[at], *([str(at + 1)] if policies.count(policies[at]) > 1 else [])]
        stem = _file_name(" ".join(words))
        for row in item.episodes.failed[:MOST_FAILURES]:
            record = replay.EpisodeRecord.of(item.entry.config, item.entry.source, row)
            yield f"{stem}_{row['episode']}.json", record


def picture_names(entries: Sequence[Entry]) -> list[str]:
    """Return a file name per scene: its terrain, and its conditions if a terrain has several."""
    return [f"{_file_name(name)}.png" for name in _scene_names(entries)]


def _scene_names(entries: Sequence[Entry]) -> list[str]:
    return scene_names([(entry.terrain, entry.conditions) for entry in entries])


def _file_name(text: str) -> str:
    return "_".join(re.findall(r"\w+", text))


def _lost_rows(folder: Path, document: Document) -> str:
    """Return, in words, the rows of earlier tables in a folder that a result lacks; "" for none.

    A row of more episodes, or with a baseline that there is no longer, is lost, too.
    """

    def counts(document: Document) -> Iterator[tuple[tuple[str, str, int, str], int]]:
        for scene in document["scenes"]:
            for summary in (scene, *compared(scene)):
                place = scene["seed"], scene["conditions"]["hash"]
                yield (scene["terrain"], summary["controller"], *place), scene["episodes"]

    # Rows that had more episodes than any of the new ones
    try:
        earlier = read_document(folder)
        most: dict[tuple[str, str, int, str], int] = {}
        for row, count in counts(document):
            most[row] = max(count, most.get(row, 0))
        lost = [(row, count) for row, count in counts(earlier) if count > most.get(row, 0)]
    except (RequestError, LookupError, TypeError):
        return ""  # there are none
    first = [
        f"{who} on {terrain}, seed {seed}, {counted(count, 'episode')}"
        for (terrain, who, seed, _), count in lost[:1]
    ]
    return " and ".join([*first, *([counted(len(lost) - 1, "more row")] if len(lost) > 1 else [])])


def _attempt(*steps: Callable[[], None]) -> None:
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
