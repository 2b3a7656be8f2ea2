"""Built-in Q-networks; importing them does not import torch, building one does."""

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
