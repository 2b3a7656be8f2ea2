"""A picture of each scene of an evaluation, or a film: the policy's first episode on it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from flipperctl.evaluation.conditions import Conditions, scene_names
from flipperctl.evaluation.runner import EpisodeRunner
from flipperctl.evaluation.scenes import Progress, Scene, no_progress
from flipperctl.report.episode import episode_figure
from flipperctl.report.figure import save
from flipperctl.report.film import save_film


def draw_scenes(folder: Path, scenes: Sequence[Scene], progress: Progress = no_progress) -> None:
    """Play the first episode of each scene again and write its picture into the folder.

    Raises:
        OutputError: a picture cannot be written.
        WriteError: writing failed half way.
    """
    conditions = [Conditions.of(config) for config, _ in scenes]
    terrains = [config.terrain.plugin_name for config, _ in scenes]
    names = picture_names(list(zip(terrains, conditions, strict=True)))
    for name, found, (config, source) in zip(names, conditions, scenes, strict=True):
        terrain = config.terrain.plugin_name
        with progress(f"{terrain}, picture", 1) as report:
            states, profile = EpisodeRunner(config, source, config.eval.seed, report).trace(0)
        title = (
            f"{source.label()} on {terrain}, conditions {found.label}, "
            f"episode 1 of {config.eval.episodes}"
        )
        figure = episode_figure(states, profile, config.robot, title)
        save(figure, folder / name)


def film_scene(path: Path, scene: Scene, progress: Progress = no_progress) -> None:
    """Play the first episode of the scene again and write its film.

    Raises:
        OutputError: the film cannot be written.
        WriteError: writing failed half way.
    """
    config, source = scene
    terrain = config.terrain.plugin_name
    with progress(f"{terrain}, film", 2) as report:
        made, profile = EpisodeRunner(config, source, config.eval.seed, report).transitions(0)
        title = f"{source.label()} on {terrain}"
        save_film(path, made, profile, config.robot, title, lambda part: report(1 + part))


def picture_names(scenes: Sequence[tuple[str, Conditions]]) -> list[str]:
    """Return a file name a scene: its terrain, and its conditions where a terrain has several."""
    return ["_".join(re.findall(r"\w+", name)) + ".png" for name in scene_names(scenes)]
