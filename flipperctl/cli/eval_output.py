"""What ``flipperctl eval`` prints and writes, in the order of its worth: numbers before pictures.

In: the result of an evaluation. Out: a table or JSON on stdout, files, pictures and a film. What
cannot be written costs nothing that comes before it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from flipperctl.errors import FlipperctlError, InterruptedRunError
from flipperctl.evaluation import files
from flipperctl.evaluation.results import EvaluationResult
from flipperctl.evaluation.scenes import Scene
from flipperctl.runs.results import result_folder
from flipperctl.terminal.progress import episodes_progress


class EvalOutput:
    """The outputs that the user named; each may be None."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        folder: Path | None,
        film: Path | None,
        record: Path | None,
        stack: ExitStack,
    ) -> None:
        """Hold the folder as long as the ``stack`` is open.

        Raises:
            OutputError: the folder cannot be written.
            RunHeldError: another process is writing results into it.
        """
        self._scenes = scenes
        self._film, self._record = film, record
        self._pictures = files.picture_names([config for config, _ in scenes])
        self._folder = None
        if folder is not None:
            names = [*files.NAMES, *self._pictures]
            self._folder = stack.enter_context(result_folder(folder, "eval", names))

    def show(self, result: EvaluationResult, label: str | None) -> None:
        """Print the tables with the policy's ``label``, or the JSON document if it is None."""
        for scene in result.scenes:
            if scene.is_one_drive:
                print(
                    f"{scene.terrain}: all {len(scene.episodes)} episodes are one and the same "
                    "drive, since nothing differs between them; their intervals mean nothing "
                    "(episode.start_noise, perception.noise, randomise or conditions=varied "
                    "make them differ)",
                    file=sys.stderr,
                )
        if label is None:
            print(result.to_json())
        else:
            _print_tables(result, label)
        sys.stdout.flush()

    def write(self, result: EvaluationResult) -> None:
        """Write tables and recorded episodes.

        Raises:
            FlipperctlError: one of them could not be written; the other was.
        """
        _attempt([lambda: self._write_tables(result), lambda: self._write_recording(result)])

    def _write_tables(self, result: EvaluationResult) -> None:
        if self._folder is not None:
            later = [] if result.interruption else self._pictures
            self._folder.replace(lambda part: files.write(part, result), later)
            names = "episodes.csv, summary.json, table.csv and table.tex"
            print(f"wrote {names} to {self._folder.path}", file=sys.stderr)

    def _write_recording(self, result: EvaluationResult) -> None:
        if self._record is not None:
            files.write_recording(self._record, self._scenes, result)
            print(f"wrote {self._record}", file=sys.stderr)

    def draw(self, result: EvaluationResult, stop: Callable[[], bool]) -> None:
        """Draw the pictures and the film; an evaluation that was interrupted gets none.

        Raises:
            InterruptedRunError: the evaluation was interrupted, or the drawing was.
            FlipperctlError: a picture or the film could not be drawn or written.
        """
        if result.interruption is not None:
            raise InterruptedRunError(result.interruption.text)
        _attempt([lambda: self._draw_scenes(stop), lambda: self._draw_film(stop)])

    def _draw_scenes(self, stop: Callable[[], bool]) -> None:
        if self._folder is None:
            return
        from flipperctl.report.scenes import draw_scenes

        draw_scenes(self._folder.path, self._scenes, episodes_progress, stop)
        print(f"wrote a picture of each scene to {self._folder.path}", file=sys.stderr)

    def _draw_film(self, stop: Callable[[], bool]) -> None:
        if self._film is None:
            return
        if stop():
            raise InterruptedRunError(f"interrupted: {self._film} is not drawn")
        from flipperctl.report.scenes import film_scene

        film_scene(self._film, self._scenes[0], episodes_progress)
        print(f"wrote {self._film}", file=sys.stderr)


def _attempt(steps: Sequence[Callable[[], None]]) -> None:
    """Take every step, also after one has failed; then raise the first error, with both texts."""
    failed: list[FlipperctlError] = []
    for step in steps:
        try:
            step()
        except FlipperctlError as error:
            failed.append(error)
    if failed:
        text = "; ".join(str(error) for error in failed)
        raise type(failed[0])(text) from failed[0]


def _print_tables(result: EvaluationResult, label: str) -> None:
    from flipperctl.terminal.conditions import condition_lines
    from flipperctl.terminal.console import console
    from flipperctl.terminal.evaluation import comparisons, search_lines, table

    out = console()
    for shown in (table(result, label), *comparisons(result)):
        shown.print(out)
    for line in search_lines(result):
        out.print(line, highlight=False, markup=False, soft_wrap=True)
    for line in condition_lines(
        (scene.terrain, scene.seed, scene.conditions) for scene in result.scenes
    ):
        out.print(line, highlight=False, markup=False, soft_wrap=True)
