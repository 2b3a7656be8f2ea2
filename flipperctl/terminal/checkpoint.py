"""The output of ``flipperctl inspect checkpoint``."""

from __future__ import annotations

from typing import Any

from flipperctl.checkpoint import Checkpoint
from flipperctl.terminal.progress import pitch_variation_text


def print_checkpoint(found: dict[str, Any], saved: Checkpoint) -> None:
    """Print a line for each part of a checkpoint (``checkpoint.contents``)."""
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
