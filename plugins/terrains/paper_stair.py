"""The paper's stair scene."""

from typing import ClassVar, Literal

from pydantic import Field

from flipperctl.api import Published, terrain

from .stair import Stair


@terrain("paper_stair")
class PaperStair(Stair):
    """Six steps 0.2 × 0.3 m up, a platform, six 0.2 × 0.2 m down; 6.5 m with the margins.

    The paper (Tab. I) gives the total length and the steps, which leave 2 m for the platform.
    """

    published: ClassVar[Published | None] = Published("paper", "paper", 41.21, 4.53, 2.60)

    fewest: int = Field(6, ge=1, le=50, description="smallest number of steps [-]")
    most: int = Field(6, ge=1, le=50, description="largest number of steps [-]")
    direction: Literal["up", "down", "both"] = Field(
        "up", description="direction of the first flight; both draws one each episode [-]"
    )
    platform: float = Field(
        2.0, ge=0, le=20, description="length of the platform after the first flight [m]"
    )
    back: bool = Field(True, description="whether a second flight leads back [-]")
    tread_down: float = Field(0.2, gt=0.05, le=2, description="depth of a step that leads down [m]")
