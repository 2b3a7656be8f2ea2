"""``flipperctl inspect terrain``."""

from __future__ import annotations

from typing import Annotated

import typer

from flipperctl.cli.options import AsJson, Overrides, Picture, PluginPaths

HELP = """Sample a terrain: the sizes of the sampled profiles, and a picture with --output.

[bold]Examples[/]

  flipperctl inspect terrain stair --output stair.png

  flipperctl inspect terrain step terrain.high=0.2 --seed 3 --draws 6 --json
"""


def run(
    name: Annotated[str, typer.Argument(help="A terrain plugin.")],
    overrides: Overrides = None,
    output: Picture = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first profile.")] = 0,
    draws: Annotated[int, typer.Option(min=1, max=100, help="Number of profiles to sample.")] = 4,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config import resolver
    from flipperctl.errors import RequestError
    from flipperctl.studies.profiles import sample
    from flipperctl.terminal.document import show
    from flipperctl.terminal.terrain import print_terrain

    for override in overrides or []:
        if override.startswith("eval."):
            raise RequestError(
                f"{override}: has no effect here; --seed and --draws choose profiles"
            )
    resolver.get("terrain", name, "terrain")
    words = [f"terrain={name}", *(overrides or [])]
    config = compose_environment(Overrides.parse(words))
    sampled = sample(config, range(seed, seed + draws))
    rows = [row for _, row in sampled]
    if output is not None:
        from flipperctl.report.figure import save
        from flipperctl.report.terrain import terrain_figure

        labels = [f"seed {row['seed']}" for row in rows]
        profiles = [profile for profile, _ in sampled]
        title = f"{name}, {labels[0]}"
        save(terrain_figure(profiles, title, config.robot, labels), output)
    document = {"terrain": resolver.container(config.terrain), "draws": rows}
    show(document, lambda: print_terrain(name, rows, output), as_json=as_json)
