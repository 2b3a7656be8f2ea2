"""Checkpoints: safetensors files that describe themselves and run no code."""

from flipperctl.checkpoint.file import (
    BEST,
    LAST,
    Checkpoint,
    describe,
    find,
    read,
    shipped,
    signed,
    write,
)

__all__ = [
    "BEST",
    "LAST",
    "Checkpoint",
    "describe",
    "find",
    "read",
    "shipped",
    "signed",
    "write",
]
