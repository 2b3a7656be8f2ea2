"""``logger=wandb``: Weights & Biases, online or as files that ``wandb sync`` sends later."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from flipperctl.api import Listener, Logger, RunInfo, logger

from .tracker import Tracker, require

if TYPE_CHECKING:
    from .tracker import TrackedRun


@logger("wandb")
class WeightsAndBiases(Logger):
    """Send a training to Weights & Biases, or keep it in the run directory for later."""

    remote: ClassVar[bool] = True
    project: str = Field("flipperctl", min_length=1, description="project of the run [-]")
    entity: str = Field("", description="user or team; empty: wandb's own default [-]")
    group: str = Field("", description="group of the run, such as that of a sweep [-]")
    mode: Literal["online", "offline"] = Field(
        "online",
        description="online: send while training, which needs wandb login once; offline: write to "
        "wandb/ in the run directory, for wandb sync [-]",
    )
    patience: float = Field(
        60.0, ge=1, le=3600, description="longest wait for wandb when the training ends [s]"
    )

    def open(self, run: RunInfo) -> Listener:
        """Start the run in its own thread.

        Raises:
            ImportError: wandb is not installed.
        """
        require("wandb")

        def begin(run_id: str) -> TrackedRun:
            import wandb

            settings = wandb.Settings(
                console="off",  # the terminal is flipperctl's
                silent=True,
                init_timeout=self.patience,
                login_timeout=self.patience,
                finish_timeout=self.patience,
            )
            tracked: TrackedRun = wandb.init(
                project=self.project,
                entity=self.entity or None,
                group=self.group or None,
                name=run.directory.resolve().name,
                id=run_id,
                resume="allow" if self.mode == "online" else None,  # offline files merge by id
                dir=run.folder,
                config=dict(run.config),
                mode=self.mode,
                reinit="create_new",  # several runs may train in one process
                settings=settings,
            )
            return tracked

        return Tracker(begin, run, self.patience)
