"""Resume a run with overrides of what a resumed run may change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import TrainConfig
from flipperctl.errors import ConfigError
from flipperctl.runs.preflight import check_device
from flipperctl.runs.training import Finished, Reports
from flipperctl.runs.training import resume as resume_run
from flipperctl.terminal.notices import print_notices

_RESUMABLE = ("train.", "device", "logger")


def resume(run: Path, words: Sequence[str], reports: Reports) -> Finished:
    """Resume a run where it stopped; ``words`` are overrides.

    Raises:
        ConfigError: an override is wrong, or changes more than a resumed run may.
        CheckpointError: it is no run, or its checkpoint is damaged.
        InterruptedRunError: the run was stopped by Ctrl-C; all is saved.
        RunHeldError: another process is training it.
    """
    for word in words:
        if "=" not in word or not word.startswith(_RESUMABLE):
            raise ConfigError(
                f"{word!r}: a resumed run keeps its configuration; "
                "only train.<field>=…, device=… and logger=… can be given with --resume"
            )

    def check(config: TrainConfig) -> None:
        check_device(config)
        print_notices(config)

    return resume_run(run, Overrides.parse(words).values(), reports, check=check)
