"""Built-in Q-networks; torch is imported only when one is built."""

from . import (
    at_d3qn,
    conv,
    dueling_mlp,
    mlp,
    noisy,
    quantile,
    stacked,
)

__all__ = ["at_d3qn", "conv", "dueling_mlp", "mlp", "noisy", "quantile", "stacked"]
