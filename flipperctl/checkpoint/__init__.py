"""Checkpoints: safetensors files that describe themselves and never execute code."""

from flipperctl.checkpoint.file import (
    BEST,
    LAST,
    Checkpoint,
    describe,
    find,
    read,
    serialize,
    shipped_policies,
    write,
)

__all__ = [
    "BEST",
    "LAST",
    "Checkpoint",
    "describe",
    "find",
    "read",
    "serialize",
    "shipped_policies",
    "write",
]
