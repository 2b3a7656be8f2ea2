"""The paper's step scene."""

from typing import ClassVar

from pydantic import Field

from flipperctl.api import Published, terrain

from .step import Step


@terrain("paper_step")
class PaperStep(Step):
    """Step 0.4 m up, 3 m of platform, 0.4 m down; 5 m with the margins (paper Tab. I)."""

    published: ClassVar[Published | None] = Published("paper", "paper", 28.07, 3.43, 1.11)

    low: float = Field(0.4, ge=-1, le=1, description="smallest height; negative leads down [m]")
    platform: float = Field(
        3.0,
        ge=0,
        le=20,
        description="length of the platform after the first step [m]",
    )
    back: bool = Field(True, description="whether a second step leads back to ground level [-]")
