"""``flipperctl eval``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.options import AsJson, Overrides, PluginPaths
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.config import EvalConfig
    from flipperctl.policies.trained import ControllerSource

HELP = """Evaluate a checkpoint or a controller on any terrain, with 95 % bootstrap intervals.

OVERRIDES apply to the evaluation, not to the trained network; terrain=a,b evaluates on both.
A checkpoint is evaluated on the terrain it was trained on unless terrain=… says otherwise, and so
is an exported .onnx file, as the robot would run it.

conditions=… says under which physics, sensing, start and randomisation: nominal (the default, for
policies and rules alike), varied, or trained (those of the checkpoint). Overrides lie on top.

[bold]Examples[/]

  flipperctl eval --checkpoint runs/stair/2026-01-31_12-00-00 --episodes 100

  flipperctl eval --checkpoint best.safetensors terrain=paper_step,paper_stair --json

  flipperctl eval --controller okada terrain=stair perception.noise=0.01 --jobs 2

  flipperctl eval --checkpoint runs/stair/2026-01-31_12-00-00 --baseline okada conditions=trained
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("eval", help=HELP)(evaluate)


def evaluate(
    overrides: Overrides = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="RUN_OR_FILE", help="A run, a checkpoint or an .onnx file."),
    ] = None,
    controller: Annotated[
        str | None, typer.Option(metavar="NAME", help="A controller plugin, such as okada.")
    ] = None,
    baseline: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="A controller to compare with, on the same draws."),
    ] = None,
    passable: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Controllers, such as okada,level,planner, that try in turn what was not crossed: "
            "success is then also told of the draws that any of them crosses.",
        ),
    ] = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes a scene [100].")
    ] = None,
    seed: Annotated[str | None, typer.Option(metavar="N", help="Seed of the draws [0].")] = None,
    jobs: Annotated[str | None, typer.Option(metavar="N", help="Processes [1].")] = None,
    output: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for episodes.csv, summary.json, pictures."),
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    if (checkpoint is None) == (controller is None):
        raise RequestError("give either --checkpoint RUN_OR_FILE or --controller NAME")
    from flipperctl import plugins as loader
    from flipperctl.cli.scenes import scenes
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.files import make_folder

    loader.load(plugins or ())
    flags = {"episodes": episodes, "seed": seed, "jobs": jobs}
    given = [*(overrides or []), *(f"eval.{k}={v}" for k, v in flags.items() if v is not None)]
    found = scenes(given, checkpoint, controller)
    against = _plugin(baseline, "--baseline") if baseline else None
    others = [_plugin(name, "--passable") for name in (passable or "").split(",") if name]
    folder = make_folder(output) if output else None

    source = found[0][1]
    document: dict[str, Any] = {"controller": source.label(), "scenes": []}
    rows = [_judge(document, config, source, against, others) for config, source in found]
    if folder:
        _write(folder, document, [row for group in rows for row in group])
        for name, (config, source) in zip(_picture_names(document), found, strict=True):
            _draw(folder / name, config, source)
    if as_json:
        print(json.dumps(document, indent=2))
        return
    from flipperctl.cli.conditions import lines
    from flipperctl.cli.console import console
    from flipperctl.cli.judged import comparison, table

    console().print(table(document))
    if baseline:
        console().print(comparison(document, baseline))
    for line in lines(document, [Conditions.of(config).line() for config, _ in found]):
        console().print(line, highlight=False, markup=False, soft_wrap=True)


def _plugin(name: str, option: str) -> ControllerSource:
    from flipperctl.config import resolver
    from flipperctl.policies.trained import ControllerSource

    plugin = resolver.create("controller", name, option)
    return ControllerSource(settings=resolver.container(plugin))


def _judge(
    document: dict[str, Any],
    config: EvalConfig,
    source: ControllerSource,
    baseline: ControllerSource | None,
    others: list[ControllerSource],
) -> list[dict[str, Any]]:
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.evaluation.statistics import differences, scene_summary

    conditions = Conditions.of(config)
    terrain = config.terrain.plugin_name
    rows = _play(config, source, f"{terrain}")
    if others:
        _cross(config, source, others, rows)
    scene = scene_summary(terrain, rows)
    scene |= {"seed": config.eval.seed, "conditions": conditions.container()}
    noted = {"conditions": conditions.name, "conditions_hash": conditions.hash}
    named = [{"scene": terrain, "controller": source.label(), **row, **noted} for row in rows]
    if baseline:
        other = _play(config, baseline, f"{terrain}, {baseline.label()}")
        scene["baseline"] = {
            "controller": baseline.label(),
            **scene_summary(terrain, other),
            "difference": differences(rows, other),
        }
        named += [
            {"scene": terrain, "controller": baseline.label(), **row, **noted} for row in other
        ]
    document["scenes"].append(scene)
    return named


def _cross(
    config: EvalConfig,
    source: ControllerSource,
    others: list[ControllerSource],
    rows: list[dict[str, Any]],
) -> None:
    """Note in each row who crossed the draw: the controller itself, or who tried after it."""
    from flipperctl.api import Outcome

    for row in rows:
        row["crossed_by"] = source.label() if row["outcome"] == Outcome.REACHED else ""
    for other in others:
        left = [row["episode"] for row in rows if not row["crossed_by"]]
        label = f"{config.terrain.plugin_name}, {other.label()} on what was not crossed"
        for row in _play(config, other, label, left):
            if row["outcome"] == Outcome.REACHED:
                rows[row["episode"]]["crossed_by"] = other.label()


def _play(
    config: EvalConfig, source: ControllerSource, label: str, only: list[int] | None = None
) -> list[dict[str, Any]]:
    from flipperctl.cli.progress import episodes_progress
    from flipperctl.evaluation.episodes import evaluate as run

    s = config.eval
    played = list(range(s.episodes)) if only is None else only
    rows: list[dict[str, Any]] = []
    with episodes_progress(label, len(played)) as report:

        def search(share: float) -> None:
            report(len(rows) + share)

        for row in run(
            config, source, episodes=played, seed=s.seed, jobs=s.jobs, report_progress=search
        ):
            rows.append(row)
            report(len(rows))
    return rows


def _write(folder: Path, document: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    import csv
    import io

    from flipperctl.files import write_bytes, write_json

    text = io.StringIO()
    writer = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(folder / "episodes.csv", text.getvalue().encode())
    write_json(folder / "summary.json", document)


def _picture_names(document: dict[str, Any]) -> list[str]:
    """A file name a scene: its terrain, numbered from the second scene on it."""
    terrains = [scene["terrain"] for scene in document["scenes"]]
    counts = [terrains[:index].count(terrain) for index, terrain in enumerate(terrains)]
    return [
        f"{terrain}_{before + 1}.png" if before else f"{terrain}.png"
        for terrain, before in zip(terrains, counts, strict=True)
    ]


def _draw(file: Path, config: EvalConfig, source: ControllerSource) -> None:
    """A picture of the scene's first episode."""
    from flipperctl.cli.progress import episodes_progress
    from flipperctl.evaluation.episodes import Player
    from flipperctl.report.episode import episode_figure
    from flipperctl.report.figure import save

    terrain = config.terrain.plugin_name
    with episodes_progress(f"{terrain}, picture", 1) as report:
        states, profile = Player(config, source, config.eval.seed, report).trace(0)
    figure = episode_figure(states, profile, config.robot, f"{source.label()} on {terrain}")
    save(figure, file)
