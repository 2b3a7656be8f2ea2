"""Built-in terrains."""

from . import combinators, mixes, obstacles, profile_file, rough, rows, stairs, worn

__all__ = ["combinators", "mixes", "obstacles", "profile_file", "rough", "rows", "stairs", "worn"]
