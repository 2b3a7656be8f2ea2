"""``flipperctl inspect terrain``."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli import options

HELP = """Sample profiles of a terrain: their sizes, and a picture with --output.

[bold]Examples[/]

  flipperctl inspect terrain stair --output stair.png

  flipperctl inspect terrain step terrain.high=0.2 --seed 3 --draws 6 --json
"""


def run(
    name: Annotated[str, typer.Argument(help="A terrain plugin.")],
    overrides: options.Overrides = None,
    output: options.Picture = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first profile.")] = 0,
    draws: Annotated[int, typer.Option(min=1, max=100, help="Number of profiles to sample.")] = 4,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import resolver
    from flipperctl.errors import RequestError
    from flipperctl.figures.terrain import sample
    from flipperctl.terminal.streams import show
    from flipperctl.terminal.tables import print_terrain

    for override in overrides or []:
        if override.startswith("eval."):
            raise RequestError(
                f"{override}: has no effect here; --seed and --draws choose the profiles"
            )
    resolver.get("terrain", name, "terrain")
    words = [f"terrain={name}", *(overrides or [])]
    config = compose_environment(Overrides.parse(words))
    sampled = sample(config, range(seed, seed + draws))
    rows = [row for _, row in sampled]
    if output is not None:
        from flipperctl.figures.figure import save
        from flipperctl.figures.terrain import terrain_figure

        profiles, labels = [p for p, _ in sampled], [f"seed {row['seed']}" for row in rows]
        save(terrain_figure(profiles, f"{name}, {labels[0]}", config.robot, labels), output)
    document = {"terrain": resolver.to_dict(config.terrain), "draws": rows}
    show(document, lambda: print_terrain(name, rows, output), as_json=as_json)
