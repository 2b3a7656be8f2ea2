"""``flipperctl inspect``: plugins, terrains, checkpoints, runs and settings."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import CheckpointError, RequestError
from flipperctl.terminal.streams import show

if TYPE_CHECKING:
    from flipperctl.api import Profile
    from flipperctl.checkpoint import Checkpoint


def plugins(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Only these plugins, or those of a package."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Run the conformance suite; fail if a check fails.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="With --check: a folder for pictures of the terrains."),
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """List every registered plugin and where it is defined.

    [bold]flipperctl explain NAME[/] shows its settings. With [bold]--check[/], run the conformance
    suite instead. It tries terrains at every bound, rewards on recorded episodes of every outcome,
    networks with their ONNX export, and controllers within a time limit. Of engines and sensors it
    probes signs, frames and units.

    [bold]Examples[/]

      flipperctl inspect plugins

      flipperctl inspect plugins stair step --json

      flipperctl inspect plugins --plugins my_terrain.py

      flipperctl inspect plugins mine --check --plugins mine.py --output pictures
    """
    from flipperctl.api import registry
    from flipperctl.config.describe import describe_plugin
    from flipperctl.plugging.plugins import broken_plugins, plugin_keys
    from flipperctl.terminal.tables import print_checks, print_plugins

    if output is not None and not check:
        raise RequestError("--output needs --check; inspect terrain draws a single picture")
    # Plugins that do not load are listed too, since their absence is what people look for.
    left_out = broken_plugins(names or ())
    keys = plugin_keys(names or ())
    if check:
        from flipperctl.terminal.progress import steps_progress
        from flipperctl.testing import checks
        from flipperctl.testing.check import require_passed, run_checks

        # The suite, whose result is shown before a failure ends the command
        wanted = checks(*(registry[key] for key in keys), pictures=output)
        with steps_progress("check") as report:
            rows = run_checks(wanted, report)
        show(rows, lambda: print_checks(rows), as_json=as_json)
        require_passed(rows)
        return
    descriptions = [describe_plugin(*key) for key in keys] + ([] if names else left_out)
    show(descriptions, lambda: print_plugins(descriptions), as_json=as_json)


def terrain(
    name: Annotated[str, typer.Argument(help="A terrain plugin.")],
    overrides: options.Overrides = None,
    output: options.Picture = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the first profile.")] = 0,
    draws: Annotated[
        int, typer.Option(metavar="N", min=1, max=100, help="Number of profiles to sample.")
    ] = 4,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Sample profiles of a terrain: their sizes, and a picture with --output.

    [bold]Examples[/]

      flipperctl inspect terrain stair --output stair.png

      flipperctl inspect terrain step terrain.height=0.2 --seed 3 --draws 6 --json
    """
    from flipperctl.config import resolver
    from flipperctl.figures.terrain import sample
    from flipperctl.requests.compose import compose_environment
    from flipperctl.requests.text import from_words
    from flipperctl.terminal.tables import print_terrain
    from flipperctl.text.messages import spans

    # Settings of an evaluation choose no profiles.
    for override in overrides or []:
        if override.startswith("eval."):
            raise RequestError(
                f"{override}: has no effect here; --seed and --draws choose the profiles"
            )
    resolver.get("terrain", name, "terrain")
    words = [f"terrain={name}", *(overrides or [])]
    config = compose_environment(from_words(words))
    sampled = sample(config, range(seed, seed + draws))
    rows = [row for _, row in sampled]
    if output is not None:
        from flipperctl.figures.figure import save
        from flipperctl.figures.terrain import terrain_figure

        # A picture that says in its file how it was made
        # Ground that is the same for several seeds is drawn once.
        seeds: dict[bytes, list[int]] = {}
        profiles: dict[bytes, Profile] = {}
        for profile, row in sampled:
            key = profile.points.tobytes()
            seeds.setdefault(key, []).append(row["seed"])
            profiles.setdefault(key, profile)
        labels = [f"seed{'s' * (len(alike) > 1)} {spans(alike)}" for alike in seeds.values()]
        about = " ".join(words)
        save(terrain_figure(list(profiles.values()), config.robot, labels), output, about)
    document = {"terrain": resolver.to_dict(config.terrain), "draws": rows}
    show(document, lambda: print_terrain(config.terrain.title, rows, output), as_json=as_json)


def checkpoint(
    path: Annotated[Path, typer.Argument(metavar="RUN_OR_FILE", help="A run or a checkpoint.")],
    overrides: options.Overrides = None,
    check: Annotated[
        bool, typer.Option("--check", help="Probe the conventions; fail if one does not hold.")
    ] = False,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Describe a checkpoint. Nothing in the file is executed, and no plugin is needed.

    The SHA-256 of the content covers configuration, results, state and weights: it is equal for
    equal runs, whatever versions of the packages wrote them.

    With [bold]--check[/], probe signs, frames, units and timing with the file's robot and
    observation. In two engines the robot drives on level ground, raises and lowers each pair of
    flippers, and drives up a ramp. The sensor measures a step. Actions, targets and period of an
    exported .onnx file are compared with that robot, or with yours after robot.… overrides. sim=…
    names the engine that is probed beside the default one. Fail if any of it differs from the
    contract.

    [bold]Examples[/]

      flipperctl inspect checkpoint runs/stair/2026-01-31_12-00-00

      flipperctl inspect checkpoint best.safetensors --json

      flipperctl inspect checkpoint policy.onnx --check robot.flipper_speed=0.5
    """
    from flipperctl import checkpoint
    from flipperctl.policies.source import load_policy

    source = load_policy(path, takes="file")
    file = source.file
    if check:
        from flipperctl.config.words import with_default, with_engine
        from flipperctl.requests.compose import compose_environment, register_trained
        from flipperctl.requests.text import from_words
        from flipperctl.testing.conventions import probe, require_conventions, table
        from flipperctl.text.show import console, print_table

        # The robot and the observation are the file's; its ground and rewards are not needed.
        words = with_engine(list(overrides or []))
        for group, name in (("terrain", "flat"), ("rewards", "paper")):
            words = with_default(words, group, name)
        primary = register_trained(source.config())
        probes = probe(compose_environment(from_words(words), primary), source)
        holds = all(measured.holds for measured in probes)
        document = {"holds": holds, "probes": [{**asdict(p), "holds": p.holds} for p in probes]}
        show(document, lambda: print_table(table(probes), console()), as_json=as_json)
        require_conventions(probes)
        return
    if overrides:
        raise RequestError(f"{overrides[0]}: overrides need --check")
    if source.is_exported:
        raise RequestError(
            f"{file} is an exported file, not a checkpoint; "
            f"python -m flipperctl.runtime {shlex.quote(str(file))} prints its interface, "
            "and --check probes it"
        )
    saved = checkpoint.read(file)
    content = saved.to_dict()
    show(content, lambda: print_checkpoint(content, saved), as_json=as_json)


def print_checkpoint(content: dict[str, Any], saved: Checkpoint) -> None:
    """Print a line for each part of a checkpoint (``Checkpoint.to_dict``)."""
    from flipperctl.terminal.progress import success_text
    from flipperctl.text.show import console, print_facts

    # What the file has of each of its parts, as far as there is anything
    config, state, document = content["config"], content.get("state") or {}, saved.document
    kind = "the best policy" if content["kind"] == "best" else "a whole run to resume"
    weights = (f"{name} (weight {term['weight']:g})" for name, term in config["rewards"].items())
    best = document.validation or (document.state.best if document.state else None)
    foreign = [
        f"{p.kind} {p.name} ({p.file or p.module})"
        for p in document.plugins
        if p.file or not p.module.startswith("flipperctl")
    ]
    lines = {
        "file": f"{content['path']} ({content['bytes']} bytes, SHA-256 matches)",
        "content": f"SHA-256 {content['content_sha256']}",
        "holds": f"{kind}, format {content['format']}",
        "trained on": f"{config['terrain']['name']}, seed {config['seed']}",
        "network": config["network"]["name"],
        "rewards": ", ".join(weights),
        "decision": str(content.get("decision") or state.get("decision")),
        "numbers": ", ".join(f"{name} {count}" for name, count in content["numbers"].items()),
        "versions": ", ".join(map(" ".join, content["versions"].items())),
        "plugins": ", ".join(foreign) or "all of flipperctl's own",
    }
    if best:
        lines["best"] = f"at decision {best.decision}: {success_text(best.model_dump())}"
    print_facts(lines, console())


def run(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A run directory.")],
    output: options.Picture = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Summarise a training run, and plot its learning curves with --output.

    [bold]Examples[/]

      flipperctl inspect run runs/stair/2026-01-31_12-00-00 --output curves.png
    """
    from flipperctl.training.folder import read_run, summarise

    episodes, validations = read_run(run)
    if output is not None:
        from flipperctl.figures.curves import METRICS, curves_figure
        from flipperctl.figures.figure import WIDTH, save

        metrics = (*METRICS, "loss")
        drawn = curves_figure({str(run): [[*episodes, *validations]]}, metrics, width=WIDTH)
        save(drawn, output, str(run))
    document = summarise(run, episodes, validations)
    show(document, lambda: _print(document, output), as_json=as_json)


def _print(document: dict[str, Any], picture: Path | None) -> None:
    """Print a row for each validation (``training.folder.summarise``), and the picture's name."""
    from flipperctl import checkpoint
    from flipperctl.process import session
    from flipperctl.terminal.progress import HEADING, PAPERS_HEADING
    from flipperctl.text.messages import percent
    from flipperctl.text.show import Column, Table, console, print_table, print_text

    # Whether the run goes on, has ended, or can be resumed
    summary = document["summary"]
    state = "still running" if document["running"] else "finished"
    if not (document["running"] or (summary and summary["finished"])):
        ended, run = (
            "interrupted" if summary else "ended by an error, or killed",
            Path(document["run"]),
        )
        state = f"{ended}; resume with: {session.command('train', '--resume', run)}"
        files: list[str] = []
        if not session.plugin_paths():  # a run records the names of its plugins' files alone
            with contextlib.suppress(CheckpointError):  # train --resume says what is damaged
                named = checkpoint.read(run / checkpoint.LAST).document.plugins
                files = list(dict.fromkeys(p.file for p in named if p.file))
        state += f" (and --plugins for {', '.join(files)})" if files else ""
    rows = [
        row
        | {
            "decision": f"{row['decision']:.0f}",
            "success": percent(row["success_rate"]),
            "mean_return": row["return"] if row["mean_return"] is None else row["mean_return"],
        }
        for row in document["validations"]
    ]
    columns = (
        Column("decision", "decision", named=True),
        Column("success", "success"),
        Column("pitch_variation_100hz", HEADING, 3),
        Column("pitch_variation_decisions", PAPERS_HEADING, 3),
        Column("t_cost", "time [s]", 1),
        Column("mean_return", "return"),
    )
    print_table(Table(columns, rows, f"{document['run']}: {state}"), console())
    if picture is not None:
        print_text(f"picture: {picture}")


def config(
    overrides: options.Overrides = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """Print the composed, validated training configuration as YAML.

    [bold]flipperctl explain KEY[/] explains a setting.

    [bold]Examples[/]

      flipperctl inspect config terrain=stair

      flipperctl inspect config experiment=wide_stair agent.gamma=0.98 --json
    """
    from omegaconf import OmegaConf

    from flipperctl.config import to_dict
    from flipperctl.requests import compose
    from flipperctl.requests.text import from_words

    config = compose.only_one(compose.compose_train(from_words(overrides or ())))
    plain = to_dict(config)
    show(plain, lambda: print(OmegaConf.to_yaml(plain).rstrip()), as_json=as_json)
