"""``flipperctl inspect terrain``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths

if TYPE_CHECKING:
    from flipperctl.api import Profile

HELP = """Sample a terrain: the sizes of the sampled profiles, and a picture with --output.

[bold]Examples[/]

  flipperctl inspect terrain stair --output stair.png

  flipperctl inspect terrain step terrain.high=0.2 --seed 3 --draws 6 --json
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("terrain", help=HELP)(show)


def show(
    name: Annotated[str, typer.Argument(help="A terrain plugin.")],
    overrides: Overrides = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A picture: .png, .svg or .pdf.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first profile.")] = 0,
    draws: Annotated[int, typer.Option(min=1, max=100, help="Number of profiles to sample.")] = 4,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import plugins as loader
    from flipperctl.cli.hydra import compose, config_store
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import resolver
    from flipperctl.env.flipper_env import FlipperEnv
    from flipperctl.errors import RequestError

    for override in overrides or []:
        if override.startswith("eval."):
            raise RequestError(
                f"{override}: has no effect here; --seed and --draws choose profiles"
            )
    loader.load(plugins or ())
    resolver.get("terrain", name, "terrain")
    config_store.register_defaults()
    config = compose.compose_environment(Overrides.parse([f"terrain={name}", *(overrides or [])]))
    env = FlipperEnv(config=config)
    profiles, point_counts = [], []
    for index in range(draws):
        env.reset(seed=seed + index)  # as in an episode, so that invalid profiles are found here
        profiles.append(env.profile)
        point_counts.append(env.points_drawn)
    seeds = range(seed, seed + draws)
    numbers = [
        {"seed": number, **describe(profile), "points_drawn": count}
        for number, profile, count in zip(seeds, profiles, point_counts, strict=True)
    ]
    if output is not None:
        from flipperctl.report.figure import save
        from flipperctl.report.terrain import terrain_figure

        labels = [f"seed {number}" for number in seeds]
        title = f"{name}, {labels[0]}"
        save(terrain_figure(profiles, title, config.robot, labels), output)
    if as_json:
        document = {"terrain": resolver.container(config.terrain), "draws": numbers}
        print(json.dumps(document, indent=2))
        return
    _print(name, numbers)
    if any(row["points_drawn"] > len(row["points"]) for row in numbers):
        most = max(row["points_drawn"] for row in numbers)
        print(f"sampled with up to {most} points; those too fine for a track to feel are left out")
    if output is not None:
        print(f"picture: {output}")


def describe(profile: Profile) -> dict[str, Any]:
    """Return the extent, heights and steepness of a profile, and its points in world [m]."""
    import numpy as np

    points = profile.points
    steps = np.diff(points, axis=0)  # (V - 1, 2) [m]
    faces = steps[steps[:, 0] == 0, 1]
    slopes = np.degrees(np.arctan2(steps[:, 1], steps[:, 0]))[steps[:, 0] > 0]
    return {
        "length": float(profile.end - profile.start),
        "lowest": float(points[:, 1].min()),
        "highest": float(points[:, 1].max()),
        "climb": float(points[-1, 1] - points[0, 1]),
        "largest_face": float(np.abs(faces).max(initial=0.0)),
        "steepest_slope_degrees": float(np.abs(slopes).max(initial=0.0)),
        "points": points.tolist(),
    }


def _print(name: str, numbers: list[dict[str, Any]]) -> None:
    from flipperctl.terminal.console import console
    from flipperctl.terminal.tables import Table

    headings = (
        *("seed", "length [m]", "lowest [m]", "highest [m]", "climb [m]"),
        *("largest face [m]", "steepest slope [°]", "points"),
    )
    table = Table(headings, name, right=headings)
    keys = ("length", "lowest", "highest", "climb", "largest_face", "steepest_slope_degrees")
    cells = [(*(f"{row[key]:.3f}" for key in keys), str(len(row["points"]))) for row in numbers]
    seeds = [str(row["seed"]) for row in numbers]
    if len(numbers) > 1 and all(row["points"] == numbers[0]["points"] for row in numbers):
        seeds, cells = ["any"], cells[:1]  # nothing about the terrain is random
    for seed, row in zip(seeds, cells, strict=True):
        table.add(seed, *row)
    table.print(console())
