"""Built-in Q-networks; torch is imported only when one is built."""

from . import d3qn

__all__ = ["d3qn"]
