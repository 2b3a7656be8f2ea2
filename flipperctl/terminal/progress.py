"""Live progress of trainings, episodes and measures: a bar on a terminal, else lines at times."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from flipperctl.text.messages import percent
from flipperctl.text.show import console, print_lines

HEADING, PAPERS_HEADING = "pitch variation [rad]", "at decisions [rad]"
"""Headings of the two columns in tables, in this order."""

_PLAIN_EVERY = 10.0  # [s] between two lines where there is no terminal
_KNOWN_AFTER = 3.0  # [s] after the first episode, before which compilation and workers start
_RECENT = 20.0  # [s] over which a rate is taken; updates begin later than decisions
_PERIOD = 30.0  # least time between two lines of an evaluation [s]


class EvaluationProgress:
    """Progress over all episodes of several policies: a bar on a terminal, else a line at times.

    It is called once for each policy on each scene. A controller's search before an episode counts
    as a fraction of that episode.
    """

    def __init__(self) -> None:
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
        """Yield a function to call with the number of finished episodes under the label.

        Episodes beyond the plan, as of traces and a film, raise the total.
        """
        # The bar goes on where the policies before have left it.
        before = self._done
        self._total = max(self._total, before + episodes)
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
                done = min(done, episodes)
                self._done = before + int(done)
                text = self.text(label, before + done)
                bar.update(task, completed=before + done, description=escape(text))
                # Without a terminal, a line at times
                if not console.is_terminal and time.perf_counter() - self._last >= _PERIOD:
                    self._last = time.perf_counter()
                    print(text, file=sys.stderr, flush=True)

            yield report


def episodes_progress(label: str, total: int) -> AbstractContextManager[Callable[[float], None]]:
    """Return the progress over some episodes alone; see ``EvaluationProgress``."""
    progress = EvaluationProgress()
    progress.plan(total)
    return progress(label, total)


class Rate:
    """Recent decisions per second of a training, and the time that is left."""

    def __init__(self) -> None:
        self._reports: deque[tuple[float, int]] = deque()  # time [s] and decision

    def take(self, decision: int) -> None:
        """Take the number of decisions after an episode."""
        now = time.perf_counter()
        if not self._reports or now - self._reports[-1][0] >= 0.1:
            self._reports.append((now, decision))
        while self._reports[-1][0] - self._reports[0][0] > _RECENT and len(self._reports) > 2:
            self._reports.popleft()

    @property
    def per_second(self) -> float | None:
        """Decisions per second [1/s]; None while it is unknown."""
        if not self._reports:
            return None
        (start, first), (end, last) = self._reports[0], self._reports[-1]
        return (last - first) / (end - start) if end - start >= _KNOWN_AFTER else None

    def left_text(self, decision: int, total: int) -> str:
        """Return the remaining time of the training in words; empty while it is unknown."""
        rate = self.per_second
        return f"{(total - decision) / rate:.0f} s left" if rate else ""


def validation_text(row: Mapping[str, Any]) -> str:
    """Return a validation in one line."""
    return f"validation at {row['decision']}: {success_text(row)}, return {row['mean_return']:.2f}"


def success_text(validation: Mapping[str, Any]) -> str:
    """Return the success of a validation, and the means of the episodes that were reached."""
    text = f"success {percent(validation['success_rate'])}"
    if not validation["success_rate"]:
        return text
    variation = validation["pitch_variation_100hz"]
    return f"{text}, pitch variation {variation:.2f} rad, {validation['t_cost']:.1f} s"


def state_text(row: Mapping[str, Any], rate: float | None) -> str:
    """Return the state of a training after an episode; ``rate`` in decisions per second [1/s]."""
    words = [] if rate is None else [f"{rate:.0f}/s"]
    words.append(f"success {percent(row['success_rate'])}")
    if row["epsilon"] is not None:  # of a learner with random actions
        words.append(f"ε {row['epsilon']:.2f}")
    if row["loss"] is not None:  # as it is before the first update
        words.append(f"loss {row['loss']:.4f}")
    return "  ".join(words)


class TrainingProgress:
    """The state of a training and its validations: a bar on a terminal, else a line at times."""

    def __init__(self, total: int, done: int) -> None:
        """``total`` and ``done`` are decisions."""
        self._rate, self._total, self._last = Rate(), total, time.perf_counter()
        self._bar = Progress(
            TextColumn("{task.completed}/{task.total} decisions"),
            BarColumn(bar_width=24),
            TaskProgressColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.description}"),
            console=console(stderr=True),
            disable=not sys.stderr.isatty(),
        )
        self._task = self._bar.add_task("", total=total, completed=done, left="")
        self._bar.start()

    def episode(self, row: Mapping[str, Any]) -> None:
        """Move the bar, or print a line if the last is ten seconds old."""
        decision, now = row["decision"], time.perf_counter()
        self._rate.take(decision)
        state = state_text(row, self._rate.per_second)
        left = self._rate.left_text(decision, self._total)
        self._bar.update(self._task, completed=decision, description=state, left=left)
        if self._bar.disable and now - self._last >= _PLAIN_EVERY:
            self._last = now
            self.note("  ".join(filter(None, [f"{decision}/{self._total} decisions", state, left])))

    def validation(self, row: Mapping[str, Any]) -> None:
        """Print a line above the bar."""
        self.note(validation_text(row))

    def note(self, text: str) -> None:
        """Print the text above the bar."""
        print_lines(self._bar.console, text.split("\n"))

    def close(self) -> None:
        """Stop the bar."""
        self._bar.stop()


@contextmanager
def steps_progress(label: str) -> Iterator[Callable[[str, float], None]]:
    """Yield a function of the current step of a measure and of the finished fraction.

    It moves a bar with the remaining time on a terminal, and prints a line at times elsewhere.
    """
    begun = last = time.perf_counter()
    with Progress(
        TextColumn(f"[bold]{label}[/]"),
        BarColumn(bar_width=24),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
        console=console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as bar:
        task = bar.add_task("", total=1.0)

        def report(what: str, fraction: float) -> None:
            nonlocal last
            bar.update(task, completed=fraction, description=escape(what))
            now = time.perf_counter()
            # Without a terminal, a line at times
            if bar.disable and now - last >= _PLAIN_EVERY:
                last = now
                left = f", {(now - begun) * (1 / fraction - 1):.0f} s left" if fraction > 0 else ""
                print(f"{label}: {100 * fraction:.0f} %{left}  {what}", file=sys.stderr, flush=True)

        yield report
