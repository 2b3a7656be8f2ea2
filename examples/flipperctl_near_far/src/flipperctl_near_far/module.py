"""The torch module of ``near_far``; imported only when a network is built."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from flipperctl.api import ObservationLayout


class NearFarModule(nn.Module):
    """Two views of the terrain, joined with the robot's angles."""

    scale: torch.Tensor

    def __init__(
        self,
        layout: ObservationLayout,
        near: Sequence[int],
        far: Sequence[int],
        widths: tuple[int, int, int],
        n_actions: int,
    ) -> None:
        """``near``, ``far``: bins of each view, either of which may be empty."""
        super().__init__()
        self.register_buffer("scale", torch.tensor(layout.scale, dtype=torch.float32))
        self.views = [list(view) for view in (near, far) if view]
        sizes = [width for view, width in zip((near, far), widths, strict=False) if view]
        self.eyes = nn.ModuleList(
            nn.Sequential(nn.Linear(len(view), size), nn.LeakyReLU())
            for view, size in zip(self.views, sizes, strict=True)
        )
        self.bins = layout.bins
        self.head = nn.Sequential(
            nn.Linear(sum(sizes) + 3, widths[2]), nn.LeakyReLU(), nn.Linear(widths[2], n_actions)
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """(B, N + 3) → (B, n_actions)."""
        scaled = observation / self.scale
        seen = [eye(scaled[:, view]) for eye, view in zip(self.eyes, self.views, strict=True)]
        q: torch.Tensor = self.head(torch.cat([*seen, scaled[:, self.bins :]], dim=1))
        return q
