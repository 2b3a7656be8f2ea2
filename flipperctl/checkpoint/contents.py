"""The contents of a checkpoint as plain data, for people and other programs to read."""

from __future__ import annotations

from typing import Any

from flipperctl.checkpoint.file import Checkpoint


def contents(saved: Checkpoint) -> dict[str, Any]:
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
