"""``logger=wandb``: Weights & Biases, online or as files that ``wandb sync`` sends later.

In: the rows of a training. Out: their numbers in the tracker, with decisions as steps. The library
runs in its own thread, so that a slow tracker does not delay the training.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from queue import SimpleQueue
from threading import Thread
from typing import Any, ClassVar, Literal
from uuid import uuid4

from pydantic import Field

from flipperctl.api import Listener, Logger, RunInfo, logger, scalars

_STATE = "run.json"
"""File in the logger's folder with the tracker's run id and the last decision logged for each kind
of row."""


Begin = Callable[[str], Any]
"""Starts or resumes the run of an id in the tracker; returns its handle with log and finish."""


class Tracker:
    """Record a training in a tracker; an error in its thread is raised by the next call."""

    def __init__(self, begin: Begin, run: RunInfo, patience: float) -> None:
        """``patience``: longest time that ``close`` waits for the tracker [s]."""
        self._begin, self._patience = begin, patience
        self._state = run.folder / _STATE
        self._id, self._logged = uuid4().hex[:12], {"episode": -1, "validation": -1}
        if run.resume_at is not None:
            self._restore()
        run.folder.mkdir(parents=True, exist_ok=True)
        self._rows: SimpleQueue[tuple[str, int, dict[str, float]] | None] = SimpleQueue()
        self._error: BaseException | None = None
        self._thread = Thread(target=self._work, name="tracker", daemon=True)
        self._thread.start()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Record the row's numbers."""
        self._add("episode", row)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Record the row's numbers."""
        self._add("validation", row)

    def note(self, text: str) -> None:
        """Ignore notes; a tracker would send them as alerts."""

    def close(self) -> None:
        """Wait until the tracker has finished.

        Raises:
            TimeoutError: it has not finished within ``patience``.
        """
        self._rows.put(None)
        self._thread.join(self._patience)
        if self._thread.is_alive():
            raise TimeoutError(f"it has not finished within {self._patience:g} s")
        self._raise_error()

    def _add(self, kind: str, row: Mapping[str, Any]) -> None:
        self._raise_error()
        self._rows.put((kind, row["decision"], scalars(kind, row)))

    def _raise_error(self) -> None:
        if isinstance(self._error, Exception):
            raise self._error
        if self._error is not None:  # SystemExit must not end the training
            raise RuntimeError(repr(self._error)) from self._error

    def _work(self) -> None:
        try:
            self._save()  # before the tracker has the run, so that a killed training keeps its id
            tracked = self._begin(self._id)
            while (row := self._rows.get()) is not None:
                kind, decision, values = row
                if decision > self._logged[kind]:  # a resumed run repeats logged rows exactly
                    tracked.log(values, step=decision)
                    self._logged[kind] = decision
                    if kind == "validation":
                        self._save()
            tracked.finish()
            self._save()
        except BaseException as error:  # noqa: BLE001  # raised in the training's thread
            self._error = error

    def _restore(self) -> None:
        """Restore the state of an earlier start; without a readable one, keep the new id."""
        try:
            state = json.loads(self._state.read_text())
            run_id, logged = str(state["id"]), {k: int(state[k]) for k in self._logged}
        except (OSError, ValueError, TypeError, KeyError):
            return
        self._id, self._logged = run_id, logged

    def _save(self) -> None:
        part = self._state.with_suffix(".part")
        part.write_text(json.dumps({"id": self._id, **self._logged}))
        part.replace(self._state)


@logger("wandb")
class WeightsAndBiases(Logger):
    """Send a training to Weights & Biases, or keep it in the run directory for later."""

    remote: ClassVar[bool] = True
    project: str = Field("flipperctl", min_length=1, description="project of the run [-]")
    entity: str = Field("", description="user or team; empty: wandb's own default [-]")
    group: str = Field("", description="group of the run, such as the runs of a sweep [-]")
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
        if find_spec("wandb") is None:
            raise ImportError("it needs wandb: pip install 'flipperctl[wandb]'")

        # wandb is imported and started in the logger's own thread, since both may take long.
        def begin(run_id: str) -> Any:
            import wandb

            settings = wandb.Settings(
                console="off",  # the terminal is flipperctl's
                silent=True,
                init_timeout=self.patience,
                login_timeout=self.patience,
                finish_timeout=self.patience,
            )
            return wandb.init(
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

        return Tracker(begin, run, self.patience)
