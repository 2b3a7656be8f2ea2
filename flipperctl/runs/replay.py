"""Play a recorded episode again and draw it.

In: the file of a record, and the outputs that the user named. Out: the episode, ``replay.json`` and
``replay.png``, and a film.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.replay import Replay, replay
from flipperctl.files import write_json
from flipperctl.runs.results import ResultFolder, result_folder

NAMES = ("replay.json", "replay.png")


def replay_file(
    path: Path,
    checkpoint: Path | None,
    output: Path | None,
    film: Path | None,
    *,
    progress: Progress = no_progress,
    tell: Callable[[str], None] = lambda text: None,
) -> Replay:
    """Return the episode of a record after writing its files; see ``evaluation.replay.replay``.

    ``tell`` is called with a line for each output.

    Raises:
        RequestError: the episode cannot be played here, or a path cannot be written.
        FlipperctlError: the policy failed, or a file could not be written.
    """
    with ExitStack() as stack:
        folder: ResultFolder | None = None
        if film is not None:
            from flipperctl.report.film import check_film

            check_film(film)
        if output is not None:
            folder = stack.enter_context(result_folder(output, "replay", NAMES))
        found = replay(path, checkpoint, progress)
        if folder is not None:
            folder.replace(lambda part: _write(part, found))
            tell(f"wrote {' and '.join(NAMES)} to {folder.path}")
        if film is not None:
            _film(film, found, progress)
            tell(f"wrote {film}")
    return found


def _write(folder: Path, found: Replay) -> None:
    from flipperctl.report.episode import episode_figure
    from flipperctl.report.figure import save
    from flipperctl.report.instants import samples

    write_json(folder / "replay.json", found.to_dict())
    states = [found.transitions[0].before, *(t.after for t in found.transitions)]
    robot, fine = found.transitions[0].robot, samples(found.transitions)
    figure = episode_figure(states, found.profile, robot, title(found), samples=fine)
    save(figure, folder / "replay.png")


def _film(path: Path, found: Replay, progress: Progress) -> None:
    from flipperctl.report.film import save_film

    with progress(f"{found.config.terrain.plugin_name}, film", 1) as report:
        made, speed = list(found.transitions), found.config.robot.track_speed
        save_film(path, made, found.profile, made[0].robot, title(found), report, speed=speed)


def title(found: Replay) -> str:
    """Return one line about the episode: policy, terrain, conditions, index and outcome."""
    record = found.record
    conditions = f"{record.conditions['name']} {record.conditions['hash']}"
    return (
        f"{record.policy.label} on {found.config.terrain.plugin_name}, conditions {conditions}, "
        f"episode {record.episode}: {found.episode['outcome']}"
    )
