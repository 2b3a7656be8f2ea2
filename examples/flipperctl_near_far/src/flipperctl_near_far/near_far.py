"""A Q-network for flipperctl: ``network=near_far``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("near_far")
class NearFar(Network):
    """Encode the ground near the robot and the ground beyond it in separate layers."""

    reach: float = Field(
        0.6, ge=0, le=10, description="largest distance of near ground from the centre [m]"
    )
    near: int = Field(64, ge=2, le=1024, description="number of features of the near ground [-]")
    far: int = Field(32, ge=2, le=1024, description="number of features of the far ground [-]")
    joined: int = Field(128, ge=2, le=4096, description="units of the fused layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Return a module that maps observations (B, n) in SI units to Q (B, n_actions)."""
        from flipperctl_near_far.module import NearFarModule

        centres = [(i + 0.5) * layout.bin_width - layout.reach for i in range(layout.bins)]
        centres *= layout.heights // layout.bins  # those of the highest points
        inside = [i for i, x in enumerate(centres) if abs(x) <= self.reach]
        beyond = [i for i in range(layout.heights) if i not in inside]
        widths = (self.near, self.far, self.joined)
        return NearFarModule(layout, inside, beyond, widths, n_actions)
