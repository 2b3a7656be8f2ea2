"""Write the files of an evaluation, the most important first: numbers before pictures.

In: the scenes and the result of an evaluation. Out: tables, recorded episodes, pictures and a film.
A file that cannot be written does not affect the earlier ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from flipperctl.checkpoint import recording
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.evaluation import files
from flipperctl.evaluation.failed_episodes import FAILURES, write_failures
from flipperctl.evaluation.failed_policies import error_of
from flipperctl.evaluation.judging import Progress, no_progress
from flipperctl.evaluation.results import EvaluationResult
from flipperctl.evaluation.scenes import Scene
from flipperctl.evaluation.store import FOLDER, VIEW, CellFolder, EpisodeStore, write_view
from flipperctl.files import check_output
from flipperctl.runs.follow_up import command
from flipperctl.runs.results import result_folder


class EvaluationFiles:
    """The outputs that the user named; each may be None."""

    def __init__(
        self,
        scenes: Sequence[Scene],
        stack: ExitStack,
        *,
        folder: Path | None = None,
        film: Path | None = None,
        record: Path | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Check the outputs, and lock the folder until the ``stack`` is closed.

        ``tell`` is called with a line for each output that was written. The folder gets
        a picture of each scene if there is one policy.

        Raises:
            RequestError: the film has several scenes, or the recording several observation layouts.
            OutputError: the folder cannot be written.
            RunHeldError: another process is writing results into it.
        """
        self._scenes, self._tell = scenes, tell
        several = any(source.label() != scenes[0][1].label() for _, source in scenes)
        self._film, self._record = film, record
        for option, file in (("--film", film), ("--record", record)):
            if file and several:
                raise RequestError(
                    f"{option} takes one policy, without further ones (--baseline none)"
                )
            if file and folder and file.resolve() == folder.resolve():
                raise RequestError(f"{option} {file} and --output are the same; a file is allowed")
        if film:
            _check_film(film, len(scenes))
        if record:
            check_output(record, recording.KIND)
            recording.require_one_layout(record, [config for config, _ in scenes])
        drawn = [] if several else [config for config, _ in scenes]
        self._pictures = files.picture_names(drawn)
        self._folder = None
        self.store = EpisodeStore()
        """Episodes that are not played again: those below the folder, if there is one."""
        if folder is not None:
            names = [*files.NAMES, *self._pictures, FAILURES]
            names += [] if (folder / FOLDER).is_dir() else [VIEW]
            self._folder = stack.enter_context(result_folder(folder, "eval", names, [VIEW]))
            self.store = CellFolder(folder / FOLDER, tell)

    def write(self, result: EvaluationResult) -> None:
        """Write tables and recorded episodes.

        Raises:
            FlipperctlError: one of them could not be written; the other one was.
        """
        _attempt([lambda: self._write_tables(result), lambda: self._write_recording(result)])

    def _write_tables(self, result: EvaluationResult) -> None:
        if self._folder is not None:
            later = [] if result.interruption else self._pictures
            failures: list[str] = []

            def write(part: Path) -> None:
                nonlocal failures
                files.write(part, result)
                failures = write_failures(part, self._scenes, result)

            replaced = files.replaced(self._folder.path, result)
            self._folder.replace(write, later)
            names = "episodes.csv, summary.json, table.csv and table.tex"
            write_view(self._folder.path)
            self._tell(f"wrote {names} to {self._folder.path}")
            if replaced:
                self._tell(
                    f"they replace earlier tables with {replaced}; those episodes stay in "
                    f"{self._folder.path / FOLDER}, and their words write the tables again"
                )
            if failures:
                replay = command("eval", "--replay", self._folder.path / failures[0])
                several = f"{len(failures)} failures" if len(failures) > 1 else "a failure"
                self._tell(f"recorded {several}; to play the first again: {replay}")
            for version, cells in self.store.other_versions.items():
                self._tell(
                    f"{self._folder.path / FOLDER}: {cells} of these cells were played with "
                    f"{version}, not the version here; another --output plays them again"
                )

    def _write_recording(self, result: EvaluationResult) -> None:
        if self._record is not None:
            files.write_recording(self._record, self._scenes, result)
            self._tell(f"wrote {self._record}")

    def draw(
        self,
        result: EvaluationResult,
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
        if result.failures:
            raise error_of(result.failures)
        pictures, film = self._draw_scenes, self._draw_film
        _attempt([lambda: pictures(stop, progress), lambda: film(stop, progress)])

    def _draw_scenes(self, stop: Callable[[], bool], progress: Progress) -> None:
        if self._folder is None or not self._pictures:
            return
        from flipperctl.report.scenes import draw_scenes

        draw_scenes(self._folder.path, self._scenes, progress, stop)
        self._tell(f"wrote a picture of each scene to {self._folder.path}")

    def _draw_film(self, stop: Callable[[], bool], progress: Progress) -> None:
        if self._film is None:
            return
        if stop():
            raise InterruptedRunError(f"interrupted: {self._film} is not drawn")
        from flipperctl.report.scenes import film_scene

        film_scene(self._film, self._scenes[0], progress)
        self._tell(f"wrote {self._film}")


def _check_film(path: Path, scenes: int) -> None:
    from flipperctl.report.film import check_film

    if scenes != 1:
        raise RequestError(f"--film shows one scene; {scenes} are evaluated")
    check_film(path)


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
