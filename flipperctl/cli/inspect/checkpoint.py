"""``flipperctl inspect checkpoint``."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from flipperctl.checkpoint import Checkpoint
    from flipperctl.policies.source import PolicySource

HELP = """Describe a checkpoint. Nothing in the file is executed, and no plugin is needed.

The SHA-256 of the content covers configuration, results, state and weights: it is equal for equal
runs, whatever versions of the packages wrote them.

With [bold]--check[/], probe signs, frames, units and timing with the file's robot and observation:
in two engines the robot drives on level ground, raises and lowers each pair of flippers, and drives
up a ramp; the sensor measures a step. Actions, targets and period of an exported .onnx file are
compared with that robot, or with yours after robot.… overrides. sim=… names the engine that is
probed beside the default one. Fail if any of it differs from the contract.

[bold]Examples[/]

  flipperctl inspect checkpoint runs/stair/2026-01-31_12-00-00

  flipperctl inspect checkpoint best.safetensors --json

  flipperctl inspect checkpoint policy.onnx --check robot.flipper_speed=0.5
"""


def run(
    path: Annotated[Path, typer.Argument(metavar="RUN_OR_FILE", help="A run or a checkpoint.")],
    overrides: options.Overrides = None,
    check: Annotated[
        bool, typer.Option("--check", help="Probe the conventions; fail if one does not hold.")
    ] = False,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import checkpoint
    from flipperctl.policies.source import load_policy
    from flipperctl.terminal.streams import show

    source = load_policy(path, takes="file")
    file = source.file
    if check:
        _check(source, list(overrides or []), as_json=as_json)
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
    found = saved.to_dict()
    show(found, lambda: print_checkpoint(found, saved), as_json=as_json)


def print_checkpoint(found: dict[str, Any], saved: Checkpoint) -> None:
    """Print a line for each part of a checkpoint (``Checkpoint.to_dict``)."""
    from flipperctl.terminal.progress import pitch_variation_text

    config, versions = found["config"], found["versions"]
    kind = "the best policy" if found["kind"] == "best" else "a whole run to resume"
    rewards = ", ".join(
        f"{name} (weight {term['weight']:g})" for name, term in config["rewards"].items()
    )
    state = found.get("state")
    document = saved.document
    best = document.validation or (document.state.best if document.state else None)
    lines = {
        "file": f"{found['path']} ({found['bytes']} bytes, SHA-256 matches)",
        "content": f"SHA-256 {found['content_sha256']}",
        "holds": f"{kind}, format {found['format']}",
        "trained on": f"{config['terrain']['name']}, seed {config['seed']}",
        "network": f"{config['network']['name']}",
        "rewards": rewards,
        "decision": str(found.get("decision") or (state or {}).get("decision")),
        "numbers": ", ".join(f"{name} {count}" for name, count in found["numbers"].items()),
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "plugins": ", ".join(f"{p.kind} {p.name} ({p.file or p.module})" for p in document.plugins),
    }
    if best:
        lines["best"] = (
            f"at decision {best.decision}: success {best.success_rate:.1%}, "
            f"{pitch_variation_text(best.model_dump(), 3)}, t_cost {best.t_cost:.1f} s"
        )
    for name, text in lines.items():
        print(f"{name:<11}{text}")


def _check(source: PolicySource, overrides: list[str], *, as_json: bool) -> None:
    from flipperctl.cli.hydra import config_store
    from flipperctl.cli.hydra.compose import compose_environment
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.config.words import with_engine
    from flipperctl.show import console, print_table
    from flipperctl.terminal.streams import show
    from flipperctl.testing.conventions import probe, require_conventions, table

    own = source.config()
    primary = config_store.register_robot(own.robot, own.perception.layout)
    config = compose_environment(Overrides.parse(with_engine(overrides)), primary)
    found = probe(config, source)
    holds = all(one.holds for one in found)
    document = {"holds": holds, "probes": [{**asdict(one), "holds": one.holds} for one in found]}
    show(document, lambda: print_table(table(found), console()), as_json=as_json)
    require_conventions(found)
