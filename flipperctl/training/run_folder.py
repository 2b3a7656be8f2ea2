"""What lies in a run directory, and what a run that was stopped at any moment goes on from.

Every file is written whole or not at all, so a process that is killed leaves one of few states: no
``config.yaml`` yet (no run), ``config.yaml`` without ``last.safetensors`` (nothing was decided, the
run begins again), or both (it goes on).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from flipperctl import checkpoint
from flipperctl.config import TrainConfig, parse
from flipperctl.errors import CheckpointError, ConfigError

CONFIG, METRICS, SUMMARY = Path("config.yaml"), Path("metrics.csv"), Path("summary.json")
_WRITTEN = (CONFIG, METRICS, SUMMARY, checkpoint.BEST, checkpoint.LAST)


def holds_run(directory: Path) -> bool:
    """Whether there is anything that a new run would overwrite."""
    files = (directory / name for name in (CONFIG, checkpoint.BEST, checkpoint.LAST))
    return any(file.is_file() and file.stat().st_size > 0 for file in files)


def find(run: Path) -> Path:
    """The run directory that is meant by it or by the path of its last checkpoint.

    Raises:
        CheckpointError: there is none, or the checkpoint is none to go on from.
    """
    if run.is_dir():
        if holds_run(run):
            return run
        raise CheckpointError(
            f"{run} holds neither {CONFIG} nor a checkpoint; is it a run directory? "
            "A run that was stopped before it wrote them is started anew"
        )
    file = checkpoint.find(run)
    if checkpoint.read(file).document.kind != "last":
        raise CheckpointError(
            f"{file} holds only the weights of a policy; "
            f"{checkpoint.LAST} is what a run goes on from"
        )
    directory = file.parent.parent
    if file.resolve() != (directory / checkpoint.LAST).resolve():
        raise CheckpointError(
            f"{file} does not lie in a run directory; a run goes on from its {checkpoint.LAST}"
        )
    return directory


def read(directory: Path) -> tuple[checkpoint.Checkpoint | None, TrainConfig]:
    """The checkpoint to go on from, None if the run begins again, and the run's configuration.

    Raises:
        CheckpointError: what the run goes on from is damaged, or does not fit this version.
    """
    if (directory / checkpoint.LAST).is_file():
        saved = checkpoint.read(directory / checkpoint.LAST)
        return saved, saved.config()
    document = _document(directory / CONFIG)
    if document:
        try:
            return None, parse(TrainConfig, document)
        except ConfigError as error:
            raise CheckpointError(
                f"{directory / CONFIG}: its configuration does not fit: {error}"
            ) from error
    if (directory / checkpoint.BEST).is_file():
        return None, checkpoint.read(directory / checkpoint.BEST).config()
    raise CheckpointError(
        f"{directory / CONFIG} is damaged and there is no checkpoint, so nothing can go on; "
        f"delete {directory} and start anew"
    )


def _document(path: Path) -> dict[str, Any] | None:
    """What a ``config.yaml`` says; None if it is missing or no mapping."""
    try:
        plain = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (OSError, YAMLError, OmegaConfBaseException, UnicodeDecodeError):
        return None
    return {str(key): value for key, value in plain.items()} if isinstance(plain, dict) else None


def is_finished(directory: Path, decision: int) -> bool:
    """Whether the run came to its end at this decision and said so."""
    try:
        summary = json.loads((directory / SUMMARY).read_text())
    except (OSError, ValueError):
        return False
    found = summary if isinstance(summary, dict) else {}
    return found.get("finished") is True and found.get("decisions") == decision


def clear_leftovers(directory: Path) -> None:
    """Remove what a process left that was killed while it wrote one of the run's files."""
    for name in _WRITTEN:
        path = directory / name
        path.with_name(f".{path.name}.part").unlink(missing_ok=True)
