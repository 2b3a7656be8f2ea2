"""``logger=trackio``: a local dashboard (``trackio show``), or one on Hugging Face Spaces."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from flipperctl.api import Listener, Logger, RunInfo, logger

from .tracker import Tracker, require

if TYPE_CHECKING:
    from .tracker import TrackedRun


@logger("trackio")
class Trackio(Logger):
    """Record a training in Trackio's database on this machine, or in a Hugging Face Space."""

    remote: ClassVar[bool] = True
    project: str = Field("flipperctl", min_length=1, description="project of the run [-]")
    group: str = Field("", description="group of the run, such as that of a sweep [-]")
    space: str = Field(
        "", description="Hugging Face Space, as user/name; empty: on this machine [-]"
    )
    patience: float = Field(
        60.0, ge=1, le=3600, description="longest wait for trackio when the training ends [s]"
    )

    def open(self, run: RunInfo) -> Listener:
        """Start the run in its own thread.

        Raises:
            ImportError: trackio is not installed.
        """
        require("trackio")

        def begin(run_id: str) -> TrackedRun:
            import trackio

            tracked: TrackedRun = trackio.init(
                project=self.project,
                name=f"{run.directory.resolve().name}_{run_id}",  # identifies the run on resume
                group=self.group or None,
                space_id=self.space or None,
                config=dict(run.config),
                resume="allow",
                embed=False,
            )
            return tracked

        return Tracker(begin, run, self.patience)
