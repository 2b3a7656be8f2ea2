"""An episode that was played again, as files, a picture and a film.

In: a record of an episode, or the episode replayed from it. Out: ``replay.json``, ``replay.png``, a
film, and lines of text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from flipperctl.checkpoint.results import result_folder
from flipperctl.evaluation.names import names
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.replay import Replay, replay
from flipperctl.evaluation.rows import DIGEST
from flipperctl.rollout.trace import Trace
from flipperctl.text.files import write_json

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
    """Return the episode of a record after writing its files; see ``replay``.

    ``tell`` is called with a line for each output.
    """
    with ExitStack() as stack:
        # Outputs are checked and locked before the episode is played.
        if film is not None:
            from flipperctl.figures.animation import check_film

            check_film(film)
        folder = None
        if output is not None:
            folder = stack.enter_context(result_folder(output, "replay", NAMES))
        replayed = replay(path, checkpoint, progress)
        # The document and a picture
        if folder is not None:

            def write(part: Path) -> None:
                write_json(part / "replay.json", replayed.to_dict())
                from flipperctl.figures.episode import episode_figure
                from flipperctl.figures.figure import save

                trace = Trace.of(replayed.transitions, replayed.profile)
                save(episode_figure(trace), part / "replay.png", replayed.title)

            folder.replace(write)
            tell(f"wrote {' and '.join(NAMES)} to {folder.path}")
        # A film of this episode alone
        if film is not None:
            from flipperctl.figures.film import Part, Take
            from flipperctl.figures.film import film as make_film

            config, label = replayed.config, replayed.source.label()
            terrain, seed = config.terrain.title, replayed.record.seed
            part = Part(names([label])[label], config.environment(), replayed.source, seed)
            with progress(f"{terrain}, film", 1) as report:
                take = Take(f"{terrain}, episode {replayed.record.episode}", [part])
                make_film(film, [take], report_progress=report)
            tell(f"wrote {film}")
    return replayed


def lines(replayed: Replay) -> Iterator[str]:
    """Yield outcome and measures of the episode, and whether it is bit-identical."""
    episode = replayed.episode
    yield replayed.title
    yield (
        f"{episode['decisions']} decisions, {episode['t_cost']:.2f} s, pitch variation "
        f"{episode['pitch_variation_100hz']:.3f} rad, largest pitch {episode['max_pitch']:.3f} rad"
    )
    if not replayed.differences:
        digest = f"bit-identical to the recorded episode, digest {episode[DIGEST]:.16}…"
        none = "equal to the recorded episode by its measures; it has no digest of the poses"
        yield none if replayed.record.digest is None else digest
