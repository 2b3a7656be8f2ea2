"""The torch module of ``near_far``; imported only when a network is built."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from flipperctl.api import ObservationLayout


class NearFarModule(nn.Module):
    """Encodes near and far terrain bins separately, then fuses both with the robot's angles."""

    scale: torch.Tensor

    def __init__(
        self,
        layout: ObservationLayout,
        near: Sequence[int],
        far: Sequence[int],
        widths: tuple[int, int, int],
        n_actions: int,
    ) -> None:
        """``near`` and ``far`` are the indices of each view's heights; one of them may be empty.

        ``widths`` are those of the near features, the far features and the fused layer.
        """
        super().__init__()
        self.register_buffer("scale", torch.tensor(layout.scale, dtype=torch.float32))
        self.views = [list(view) for view in (near, far) if view]
        sizes = [width for view, width in zip((near, far), widths, strict=False) if view]
        self.encoders = nn.ModuleList(
            nn.Sequential(nn.Linear(len(view), size), nn.LeakyReLU())
            for view, size in zip(self.views, sizes, strict=True)
        )
        self.heights = layout.heights
        self.head = nn.Sequential(
            nn.Linear(sum(sizes) + 3, widths[2]), nn.LeakyReLU(), nn.Linear(widths[2], n_actions)
        )

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Map observations (B, n) in SI units to Q-values (B, n_actions)."""
        scaled = observation / self.scale
        features = [
            encoder(scaled[:, view])
            for encoder, view in zip(self.encoders, self.views, strict=True)
        ]
        q: torch.Tensor = self.head(torch.cat([*features, scaled[:, self.heights :]], dim=1))
        return q
