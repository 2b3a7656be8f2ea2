"""Make a map of a policy's capability and write its files.

In: the scene of an evaluation, and the text of ``--map``. Out: the map, ``map.json``, ``map.csv``,
``map.png``, and records of failures near the boundary.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from flipperctl.config import EvalConfig
from flipperctl.config.words import with_default
from flipperctl.errors import InterruptedRunError, RequestError
from flipperctl.evaluation.axes import Axis, cell_config, parse_axes
from flipperctl.evaluation.capability import EPISODES, CapabilityMap
from flipperctl.evaluation.failed_episodes import MAP_FAILURES, write_map_failures
from flipperctl.evaluation.judging import Progress, no_progress
from flipperctl.evaluation.map_cells import capability_map
from flipperctl.evaluation.scenes import Scene
from flipperctl.files import write_csv, write_json
from flipperctl.policies.source import PolicySource
from flipperctl.runs.results import ResultFolder, result_folder

NAMES = ("map.json", "map.csv", "map.png")
"""Names of the files of a map."""


def map_words(words: list[str]) -> list[str]:
    """Return the overrides of a map, with its own number of episodes unless they set one."""
    return with_default(words, "eval.episodes", EPISODES)


def map_scenes(
    scenes: Sequence[Scene],
    text: str,
    output: Path | None,
    *,
    progress: Progress = no_progress,
    stop: Callable[[], bool] = lambda: False,
    show: Callable[[CapabilityMap], None] = lambda found: None,
    tell: Callable[[str], None] = lambda text: None,
) -> CapabilityMap:
    """Return the map of the only scene over the axes of ``text``, after writing its files.

    ``show`` is called before they are written, so that a full disk does not lose the map, and
    ``tell`` with a line for the files.

    Raises:
        RequestError: there are several scenes, or the axes cannot be read.
        ConfigError: a setting does not exist, or a cell is not possible.
        InterruptedRunError: it was stopped before any cell was finished.
        FlipperctlError: the policy failed, or a file could not be written.
    """
    if len(scenes) != 1:
        raise RequestError(f"--map shows one scene; {len(scenes)} are evaluated")
    ((config, source),) = scenes
    if config.eval.ray is not None:
        raise RequestError("eval.ray: no meaning beside --map, which plays here; leave it out")
    axes = parse_axes(text, config)
    with ExitStack() as stack:
        folder: ResultFolder | None = None
        if output is not None:
            folder = stack.enter_context(result_folder(output, "map", [*NAMES, MAP_FAILURES]))
        _tell_notes(config, source, axes, tell)
        found = capability_map(config, source, axes, progress=progress, stop=stop)
        if not found.cells:
            raise InterruptedRunError("interrupted: no cell of the map is finished")
        try:
            show(found)
        finally:  # files are written even if the pipe is closed
            if folder is not None:
                _write_all(folder, config, source, found, tell)
    return found


def _write_all(
    folder: ResultFolder,
    config: EvalConfig,
    source: PolicySource,
    found: CapabilityMap,
    tell: Callable[[str], None],
) -> None:
    recorded = 0

    def write(part: Path) -> None:
        nonlocal recorded
        write_map(part, found)
        recorded = write_map_failures(part, config, source, found)

    folder.replace(write)
    tell(f"wrote {', '.join(NAMES)} and {recorded} failures to {folder.path}")


def write_map(folder: Path, found: CapabilityMap) -> None:
    """Write all files of a map into an existing folder.

    Raises:
        OutputError: a file cannot be written.
        WriteError: writing failed half way.
    """
    from flipperctl.report.capability import capability_figure
    from flipperctl.report.figure import save

    write_json(folder / "map.json", found.to_dict())
    write_csv(folder / "map.csv", list(found.rows()))
    save(capability_figure(found), folder / "map.png")


def _tell_notes(
    config: EvalConfig, source: PolicySource, axes: tuple[Axis, Axis], tell: Callable[[str], None]
) -> None:
    """Tell what the controller does otherwise than its settings name, in which cells."""
    first, second = (range(len(axis.values)) for axis in axes)
    border = [*((i, 0) for i in first), *((0, j) for j in second)]
    notes = {
        note: cell for cell in border for note in source.notes(cell_config(config, axes, cell))
    }
    new = [(note, cell) for note, cell in notes.items() if note not in set(source.notes(config))]
    if new:
        note, cell = new[0]
        where = ", ".join(f"{a.name}={a.values[at]:g}" for a, at in zip(axes, cell, strict=True))
        more = f", and {len(new) - 1} like it in other cells" if len(new) > 1 else ""
        tell(f"in a part of the map, such as {where}: {note}{more}")
