"""A Q-network for flipperctl: ``network=near_far``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from flipperctl.api import Network, ObservationLayout, network

if TYPE_CHECKING:
    import torch


@network("near_far")
class NearFar(Network):
    """The ground under the robot and the ground beyond it, each through layers of its own."""

    reach: float = Field(0.6, ge=0, le=10, description="ground so far from the centre is near [m]")
    near: int = Field(64, ge=2, le=1024, description="features of the ground under the robot [-]")
    far: int = Field(32, ge=2, le=1024, description="features of the ground beyond [-]")
    joined: int = Field(128, ge=2, le=4096, description="units of the common layer [-]")

    def build(self, layout: ObservationLayout, n_actions: int) -> torch.nn.Module:
        """Observations (B, N + 3) in SI units → Q-values (B, n_actions)."""
        from flipperctl_near_far.module import NearFarModule

        middles = [(i + 0.5) * layout.bin_width - layout.reach for i in range(layout.bins)]
        inside = [i for i, x in enumerate(middles) if abs(x) <= self.reach]
        beyond = [i for i in range(layout.bins) if i not in inside]
        widths = (self.near, self.far, self.joined)
        return NearFarModule(layout, inside, beyond, widths, n_actions)
