"""The files of a run directory, and the state from which a stopped run is resumed.

Every file is written completely or not at all. A killed process leaves one of three states:

- no ``config.yaml``: there is no run
- ``config.yaml`` without ``last.safetensors``: no decision was made; the run begins again
- both: the run continues from the checkpoint
"""

from __future__ import annotations

import hashlib
import math
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from flipperctl import checkpoint
from flipperctl.checkpoint import former
from flipperctl.checkpoint.results import (
    CONFIG,
    HYDRA,
    METRICS,
    SUMMARY,
    holds_run,
    is_held,
    read_config,
    summary_of,
)
from flipperctl.config import TrainConfig, parse, to_dict
from flipperctl.config.identity import differences
from flipperctl.env.metrics import RENAMED, with_both_names
from flipperctl.errors import CheckpointError, ConfigError, OutputError, RequestError
from flipperctl.plugging import plugins
from flipperctl.text.files import CsvRow, make_folder, read_csv, remove_partial, write_bytes
from flipperctl.training.episodes import EPISODES, PARTS
from flipperctl.training.listeners import NAME, Companion
from flipperctl.training.sweep import REACHED, of_reached

_SUMS = "SHA256SUMS"
_LOCK = Path(".run.lock")
_WRITTEN = (CONFIG, METRICS, SUMMARY, EPISODES, checkpoint.BEST, checkpoint.LAST, Path(NAME))


def check_free(directory: Path) -> None:
    """Check that a new run would replace no file of something else, such as an evaluation."""
    for file in (directory / METRICS, directory / SUMMARY):
        if file.exists():
            raise OutputError(
                f"{file} is not of a run and would be replaced; move it, or choose another folder"
            )


def find(run: Path) -> Path:
    """Return the run directory of ``run``, a directory or the path of its last checkpoint."""
    if run.is_dir():
        if holds_run(run):
            return run
        hint = sweep_hint(run) or (
            "is it a run directory? A run that was stopped before it wrote them must be started "
            "again"
        )
        raise CheckpointError(f"{run} holds neither {CONFIG} nor a checkpoint; {hint}")
    # A file stands for its run only as that run's last checkpoint.
    file = checkpoint.find(run)
    if checkpoint.read(file).document.kind != "last":
        raise CheckpointError(
            f"{file} holds only the weights of a policy; a run is resumed from {checkpoint.LAST}"
        )
    directory = file.parent.parent
    if file.resolve() != (directory / checkpoint.LAST).resolve():
        raise CheckpointError(
            f"{file} does not lie in a run directory; a run is resumed from its {checkpoint.LAST}"
        )
    return directory


def sweep_hint(folder: Path) -> str:
    """Return why a folder is no run: it does not exist, or has runs in it; empty otherwise."""
    if not folder.exists():
        return "there is no such folder"
    if not folder.is_dir():
        return ""
    runs = sorted(filter(holds_run, folder.iterdir()), key=checkpoint.job_order)
    return f"give one of its runs, such as {runs[0]}" if runs else ""


def read(directory: Path) -> tuple[checkpoint.Checkpoint | None, TrainConfig]:
    """Return the checkpoint to resume from, None if the run begins again, and the configuration."""
    if (directory / checkpoint.LAST).is_file():
        saved = checkpoint.read(directory / checkpoint.LAST)
        config = saved.config()
        _check_unedited(directory, config)
        return saved, config
    # No decision was made yet: the settings say what begins again.
    document, fault = read_config(directory / CONFIG)
    if document:
        return None, _parsed(directory / CONFIG, document)
    if (directory / checkpoint.BEST).is_file():
        return None, checkpoint.read(directory / checkpoint.BEST).config()
    raise CheckpointError(
        f"{directory / CONFIG} is damaged ({fault}) and there is no checkpoint, so the run "
        f"cannot be resumed; delete {directory} and start the run again"
    )


def _parsed(file: Path, document: object) -> TrainConfig:
    """Return the configuration that a ``config.yaml`` states."""
    try:
        if isinstance(document, dict):
            return parse(TrainConfig, former.current(document))
        raise ConfigError("it is not a mapping")
    except ConfigError as error:
        raise CheckpointError(f"{file}: its configuration does not fit: {error}") from error


def _check_unedited(directory: Path, config: TrainConfig) -> None:
    """Refuse a ``config.yaml`` that states other settings than ``config``, the checkpoint's."""
    file = directory / CONFIG
    if not file.is_file() or not (content := file.read_bytes()):
        return
    if Companion(directory).read().has_written(content):
        return  # a kill may leave that of a resumed run before its first checkpoint
    advice = (
        "a run goes on with the configuration of its checkpoint: restore the file or delete it, "
        "and give a change to train.<field> to the command"
    )
    document, fault = read_config(file)
    if document is None:
        raise CheckpointError(f"{file} was edited: {fault}; {advice}")
    # Comments and order may differ; the settings may not.
    edited = to_dict(_parsed(file, document))
    changes = [
        f"{path}: {there} in the file, {here} in the checkpoint"
        for path, here, there in differences(to_dict(config), edited)
    ]
    if changes:
        raise CheckpointError(f"{file} was edited: {', '.join(changes)}; {advice}")


def write_config(directory: Path, config: TrainConfig, companion: Companion) -> None:
    """Write the configuration as ``config.yaml``, unless an equal one is there, comments or not."""
    if read_config(directory / CONFIG)[0] != (plain := to_dict(config)):
        content = OmegaConf.to_yaml(plain).encode()
        companion.announce(content)
        write_bytes(directory / CONFIG, content)


def keep_plugins(directory: Path) -> None:
    """Copy the plugin files of this process into the run, with their SHA-256.

    Files of several folders lie together unless two of them have one name.
    """
    if not (files := list(plugins.loaded_contents())):
        return
    # Where files of two folders have one name, each folder gets a number.
    folders = list(dict.fromkeys(file.parent for file in files))
    apart = len({file.name for file in files}) < len(files)
    place, listed = directory / checkpoint.PLUGINS, directory / checkpoint.PLUGINS / _SUMS
    # Without its sums the folder is somebody else's.
    if place.exists() and not listed.exists():
        raise OutputError(f"{place} is not of a run; move it, or choose another folder")
    sums = []
    for file in files:
        part = str(folders.index(file.parent)) if apart else ""
        copy, content = make_folder(place / part) / file.name, file.read_bytes()
        write_bytes(copy, content)
        sums.append(f"{hashlib.sha256(content).hexdigest()}  {copy.relative_to(place)}\n")
    write_bytes(listed, "".join(sums).encode())


def write_hydra(directory: Path, documents: Mapping[str, Any]) -> None:
    """Write Hydra's own record of a job: a YAML file for each document, in ``.hydra``."""
    folder = make_folder(directory / HYDRA)
    for name, document in documents.items():
        write_bytes(folder / f"{name}.yaml", OmegaConf.to_yaml(document).encode())


def differing_settings(there: TrainConfig, here: TrainConfig) -> list[str]:
    """Return each setting that differs, with both values; loggers may differ."""
    saved, requested = (
        to_dict(config.model_copy(update={"logger": {}})) for config in (there, here)
    )
    return [
        f"{path}: {first} there, {second} here"
        for path, first, second in differences(saved, requested)
    ]


def clear_leftovers(directory: Path) -> None:
    """Remove the partial files of a process that was killed while it wrote a file of the run."""
    for name in _WRITTEN:
        remove_partial(directory / name)
    for part in (directory / PARTS).glob(".*.part"):
        part.unlink()


def discard(directory: Path, loggers: Iterable[str]) -> None:
    """Remove the files of a new run and its loggers that was refused before its first decision.

    The caller holds the lock of the run, whose file is removed, too: a process that has opened it
    notices that. Other files in the directory stay.
    """
    clear_leftovers(directory)
    if (directory / checkpoint.PLUGINS / _SUMS).exists():
        shutil.rmtree(directory / checkpoint.PLUGINS)
    for name in (*_WRITTEN, _LOCK):
        (directory / name).unlink(missing_ok=True)
    for folder in (*map(Path, loggers), HYDRA):
        shutil.rmtree(directory / folder, ignore_errors=True)
    (directory / checkpoint.BEST.parent).rmdir()


_SHOWN = ("decision", "success_rate", *REACHED, "return", "mean_return")


Rows = list[CsvRow]


def read_run(run: Path) -> tuple[Rows, Rows]:
    """Return the rows of episodes and of validations in a run's ``metrics.csv``."""
    metrics = run / METRICS
    if not metrics.is_file():
        hint = sweep_hint(run) or "is it a run directory?"
        raise RequestError(f"{run} holds no {METRICS}; {hint}")
    rows = read_csv(metrics, ("kind", "decision"), RENAMED)
    for row in rows:
        if not math.isfinite(row.number("decision")):
            raise row.refusal("decision", "a finite number is allowed")
    episodes, validations = (
        [row for row in rows if row["kind"] == kind] for kind in ("episode", "validation")
    )
    return episodes, validations


def summarise(run: Path, episodes: Rows, validations: Rows) -> dict[str, Any]:
    """Return ``summary.json`` (None if missing), the number of episodes and the validations.

    ``running``: whether a process trains it now. Columns of later versions are left empty.
    """
    numbers = [
        {key: row.number(key) if row.get(key) else None for key in _SHOWN} for row in validations
    ]
    return {
        "run": str(run),
        "summary": summary_of(run) or None,
        "running": is_held(run),
        "episodes": len(episodes),
        "validations": [with_both_names(of_reached(row)) for row in numbers],
    }
