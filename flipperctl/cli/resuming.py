"""Resume a run with overrides of what a resumed run may change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig
from flipperctl.runs.preflight import check_device, check_resumable
from flipperctl.runs.training import Finished, Reports
from flipperctl.runs.training import resume as resume_run
from flipperctl.terminal.notices import print_notices


def resume(run: Path, words: Sequence[str], reports: Reports) -> Finished:
    """Resume a run where it stopped; ``words`` are overrides.

    Raises:
        ConfigError: an override is wrong, or changes more than a resumed run may.
        CheckpointError: it is no run, or its checkpoint is damaged.
        InterruptedRunError: the run was stopped by Ctrl-C; all is saved.
        RunHeldError: another process is training it.
    """
    check_resumable(words)

    def check(config: TrainConfig) -> None:
        check_device(config)
        print_notices(config)

    return resume_run(run, Overrides.parse(words).values(), reports, check=check)
