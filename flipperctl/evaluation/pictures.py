"""Pictures or films of the policy's first episode on each scene of an evaluation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from flipperctl.errors import FlipperctlError, InterruptedRunError
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import Progress, no_progress
from flipperctl.evaluation.workers import EpisodeRunner
from flipperctl.figures.episode import episode_figure, mapped
from flipperctl.figures.figure import save
from flipperctl.figures.film import film, samples, save_film
from flipperctl.rollout.seeds import EvaluationSeeds


def draw_scenes(
    scenes: Mapping[Path, Entry],
    progress: Progress = no_progress,
    stop: Callable[[], bool] = lambda: False,
) -> None:
    """Replay the first episode of each scene and write its picture, by the picture's path.

    If a picture fails, the others are still drawn.
    """
    names = [file.name for file in scenes]
    failed: list[tuple[str, FlipperctlError]] = []
    for index, (file, entry) in enumerate(scenes.items()):
        if stop():
            raise InterruptedRunError(f"interrupted: {', '.join(names[index:])} not drawn")
        try:
            _draw(file, entry, progress)
        except FlipperctlError as error:
            failed.append((file.name, error))
    if failed:
        others = ", ".join(name for name, _ in failed[1:])
        first = failed[0][1]
        raise type(first)(f"{first}; also not drawn: {others}") if others else first


def _draw(path: Path, entry: Entry, progress: Progress) -> None:
    config, source, terrain = entry.config, entry.source, entry.terrain
    with progress(f"{terrain}, picture", 1) as report:
        made, profile = EpisodeRunner(config, source, config.eval.seed, report).transitions(0)
    title = (
        f"{source.label()} on {terrain}: {made[-1].outcome}\n"
        f"episode 0 of {config.eval.episodes}, conditions {entry.conditions.label}"
    )
    states = [made[0].before, *(t.after for t in made)]
    robot = made[0].robot
    save(episode_figure(states, profile, robot, title, mapped(made), samples(made)), path)


def film_scene(path: Path, entry: Entry, progress: Progress = no_progress) -> None:
    """Replay the first episode of the scene and write its film."""
    config, source, terrain = entry.config, entry.source, entry.terrain
    if config.sim.films_itself:
        film(config, source, EvaluationSeeds.of(config.eval.seed, config.terrain)(0), path)
        return
    with progress(f"{terrain}, film", 2) as report:
        made, profile = EpisodeRunner(config, source, config.eval.seed, report).transitions(0)
        title = f"{source.label()} on {terrain}: {made[-1].outcome}"
        robot, speed = made[0].robot, config.robot.track_speed
        save_film(path, made, profile, robot, title, lambda part: report(1 + part), speed=speed)
