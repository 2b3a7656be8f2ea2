"""A network of your own, whose last layer also sees the observation.

Try it: ``flipperctl train terrain=stair network=skip --plugins examples/skip.py``
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("skip")
class Skip(Network):
    """Two hidden layers; the last layer also sees the observation itself."""

    width: int = Field(128, ge=2, le=4096, description="units of each hidden layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        import torch
        from torch import nn

        class Module(nn.Module):
            def __init__(self, width: int) -> None:
                super().__init__()
                scale = torch.tensor(layout.scale, dtype=torch.float32)
                self.register_buffer("scale", scale)  # moves with the module and is exported
                self.first = nn.Linear(layout.size, width)
                self.second = nn.Linear(width, width)
                self.last = nn.Linear(width + layout.size, n_actions)

            def forward(self, observation: torch.Tensor) -> torch.Tensor:
                x = observation / self.scale
                hidden = nn.functional.leaky_relu(
                    self.second(nn.functional.leaky_relu(self.first(x)))
                )
                return self.last(torch.cat([hidden, x], dim=1))

        return Module(self.width)
