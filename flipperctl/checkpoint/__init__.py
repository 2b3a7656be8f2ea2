"""Checkpoints: safetensors files that describe themselves and never execute code."""

from flipperctl.checkpoint.file import (
    BEST,
    LAST,
    PLUGINS,
    TRUST,
    Checkpoint,
    describe,
    find,
    holds,
    job_order,
    plugged,
    plugin_references,
    read,
    read_policy,
    runs_in,
    shipped_policies,
    write,
)
from flipperctl.checkpoint.sealed import serialize

__all__ = [
    "BEST",
    "LAST",
    "PLUGINS",
    "TRUST",
    "Checkpoint",
    "describe",
    "find",
    "holds",
    "job_order",
    "plugged",
    "plugin_references",
    "read",
    "read_policy",
    "runs_in",
    "serialize",
    "shipped_policies",
    "write",
]
