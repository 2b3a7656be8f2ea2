"""Live progress of a training and of episodes: a bar on a terminal, else lines for a training."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from flipperctl.api import Listener
from flipperctl.terminal.console import console
from flipperctl.terminal.pitch_variation import pitch_variation_text

_PLAIN_EVERY = 10.0  # [s]
_KNOWN_AFTER = 20.0  # [s]; before that, compilation and the start of workers distort the rate


def progress(total: int, done: int) -> Listener:
    """Return a bar if stderr is a terminal, else lines; ``total`` and ``done`` are decisions."""
    return Bar(total, done) if sys.stderr.isatty() else Lines(total, done)


@contextmanager
def episodes_progress(label: str, total: int) -> Iterator[Callable[[float], None]]:
    """Show a bar on a terminal; yield a function to call with the number of finished episodes.

    A controller's search before an episode counts as a fraction of that episode.
    """
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(escape(label), total=total)

        def report(done: float) -> None:
            bar.update(task, completed=done)

        yield report


class EvaluationProgress:
    """Progress over all episodes of several policies: a bar on a terminal, else a line at times.

    It is called as ``episodes_progress`` is, once for each policy on each scene.
    """

    def __init__(self, every: float = 30.0) -> None:
        """``every``: least time between two lines [s]."""
        self._every = every
        self._total = self._done = 0
        self._started = self._last = time.perf_counter()

    def plan(self, total: int) -> None:
        """Take the number of all episodes that are to be played."""
        self._total = total
        self._started = self._last = time.perf_counter()

    def text(self, label: str, done: float) -> str:
        """Return the state after ``done`` episodes of all."""
        if done <= 0 or done >= self._total:
            return f"{done:.0f} of {self._total} episodes, {label}"
        left = (time.perf_counter() - self._started) * (self._total - done) / done
        return f"{done:.0f} of {self._total} episodes, {left:.0f} s left, {label}"

    @contextmanager
    def __call__(self, label: str, episodes: int) -> Iterator[Callable[[float], None]]:
        """Yield a function to call with the number of finished episodes under the label."""
        before = self._done
        console = Console(stderr=True)
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        ) as bar:
            task = bar.add_task("", total=max(1, self._total), completed=before)

            def report(done: float) -> None:
                self._done = before + int(done)
                text = self.text(label, before + done)
                bar.update(task, completed=before + done, description=escape(text))
                if not console.is_terminal and time.perf_counter() - self._last >= self._every:
                    self._last = time.perf_counter()
                    print(text, file=sys.stderr, flush=True)

            yield report


class Rate:
    """Decisions per second since this object was made, and the time that is left."""

    def __init__(self, done: int) -> None:
        """``done``: decisions that were made before."""
        self._start = time.perf_counter()
        self._done = done

    def seconds_left(self, decision: int, total: int) -> str:
        """Return the remaining time of the training [s], or ``–`` while it is unknown."""
        if time.perf_counter() - self._start < _KNOWN_AFTER or decision <= self._done:
            return "–"
        return f"{(total - decision) / self(decision):.0f}"

    def __call__(self, decision: int) -> float:
        """Return the decisions per second [1/s]."""
        return (decision - self._done) / max(1e-9, time.perf_counter() - self._start)


def validation_text(row: Mapping[str, Any]) -> str:
    """Return a validation in one line."""
    return (
        f"validation at {row['decision']}: success {row['success_rate']:.0%}, {way_text(row)}, "
        f"return {row['mean_return']:.2f}"
    )


def way_text(validation: Mapping[str, Any]) -> str:
    """Return the means of the episodes of a validation that reached the finish."""
    if not validation["success_rate"]:
        return "no finish reached"
    return f"{pitch_variation_text(validation, 2)}, {validation['t_cost']:.1f} s"


def state_text(row: Mapping[str, Any], rate: float) -> str:
    """Return the state of a training after an episode; ``rate`` in decisions per second [1/s]."""
    loss = "–" if row["loss"] is None else f"{row['loss']:.4f}"  # before the first update
    return f"{rate:.0f}/s  success {row['success_rate']:.0%}  ε {row['epsilon']:.2f}  loss {loss}"


class Bar:
    """A rich progress bar with the state of the training, and its validations above it."""

    def __init__(self, total: int, done: int) -> None:
        self._rate = Rate(done)
        self._progress = Progress(
            TextColumn("{task.completed}/{task.total} decisions"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TextColumn("{task.fields[left]} s left"),
            TextColumn("{task.description}"),
            console=console(stderr=True),
        )
        self._total = total
        self._task = self._progress.add_task("", total=total, completed=done, left="–")
        self._progress.start()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Move the bar."""
        decision = row["decision"]
        text, left = (
            state_text(row, self._rate(decision)),
            self._rate.seconds_left(decision, self._total),
        )
        self._progress.update(self._task, completed=decision, description=text, left=left)

    def validation(self, row: Mapping[str, Any]) -> None:
        """Print a line above the bar."""
        self._progress.update(self._task, completed=row["decision"])
        self._progress.console.print(validation_text(row), highlight=False)

    def note(self, text: str) -> None:
        """Print the text above the bar."""
        self._progress.console.print(text, highlight=False, markup=False)

    def close(self) -> None:
        """Stop the bar."""
        self._progress.stop()


class Lines:
    """Progress as a line every ten seconds and at each validation."""

    def __init__(self, total: int, done: int) -> None:
        self._rate = Rate(done)
        self._total = total
        self._last = time.perf_counter()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Print a line if the last is ten seconds old."""
        now = time.perf_counter()
        if now - self._last < _PLAIN_EVERY:
            return
        self._last = now
        decision, rate = row["decision"], self._rate(row["decision"])
        left = self._rate.seconds_left(decision, self._total)
        print(
            f"{decision}/{self._total} decisions  {state_text(row, rate)}  {left} s left",
            file=sys.stderr,
            flush=True,
        )

    def validation(self, row: Mapping[str, Any]) -> None:
        """Print a line."""
        print(validation_text(row), file=sys.stderr, flush=True)

    def note(self, text: str) -> None:
        """Print the text."""
        print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Do nothing; lines need no clean-up."""
