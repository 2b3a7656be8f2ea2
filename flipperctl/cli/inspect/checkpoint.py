"""``flipperctl inspect checkpoint``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli.options import AsJson, PluginPaths
from flipperctl.terminal.pitch_variation import swing_text

if TYPE_CHECKING:
    from flipperctl.checkpoint import Checkpoint

HELP = """Describe a checkpoint. Nothing in the file is executed, and no plugin is needed.

The content's SHA-256 covers configuration, results, state and weights: it is equal for equal runs,
with any versions of the packages that wrote them.

[bold]Examples[/]

  flipperctl inspect checkpoint runs/stair/2026-01-31_12-00-00

  flipperctl inspect checkpoint best.safetensors --json
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("checkpoint", help=HELP)(show)


def show(
    path: Annotated[Path, typer.Argument(metavar="RUN_OR_FILE", help="A run or a checkpoint.")],
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl import checkpoint
    from flipperctl import plugins as loader

    loader.load(plugins or ())
    saved = checkpoint.read(checkpoint.find(path))
    found = describe(saved)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    _print(found, saved)


def describe(saved: Checkpoint) -> dict[str, Any]:
    """Return the checkpoint as plain data, with the run's state but without its generators."""
    document = saved.document.plain()
    state = document.pop("state", None)
    if state:
        document["state"] = {k: v for k, v in state.items() if k not in ("generators", "recent")}
    prefixes = dict.fromkeys(name.partition(".")[0] for name in saved.tensors)
    numbers = {prefix: sum(t.numel() for t in saved.part(prefix).values()) for prefix in prefixes}
    return {
        "path": str(saved.path),
        "bytes": saved.path.stat().st_size,
        "content_sha256": saved.content,
        "numbers": numbers,
        **document,
    }


def _print(found: dict[str, Any], saved: Checkpoint) -> None:
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
        "plugins": ", ".join(
            f"{p.kind} {p.name} ({p.origin or p.module})" for p in document.plugins
        ),
    }
    if best:
        lines["best"] = (
            f"at decision {best.decision}: success {best.success_rate:.1%}, "
            f"{swing_text(best.model_dump(), 3)}, t_cost {best.t_cost:.1f} s"
        )
    for name, text in lines.items():
        print(f"{name:<11}{text}")
