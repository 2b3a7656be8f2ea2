"""``flipperctl eval`` of several policies, or on a suite: one table for all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from flipperctl.cli.methods import method_scenes
from flipperctl.evaluation.best_known import with_best_known
from flipperctl.evaluation.groups import grouped, parse
from flipperctl.evaluation.scenes import evaluate
from flipperctl.runs.evaluation import EvaluationFiles
from flipperctl.runs.interrupts import interrupts
from flipperctl.runs.methods import Entrant, standing
from flipperctl.runs.named_policies import controllers
from flipperctl.runs.suites import Suite
from flipperctl.terminal.progress import EvaluationProgress
from flipperctl.terminal.results import print_result
from flipperctl.terminal.streams import print_note


def run(
    words: Sequence[str],
    policies: Sequence[Entrant],
    suite: Suite | None,
    baseline: str | None,
    passable: str | None,
    by: str | None,
    *,
    outputs: Mapping[str, Path | None],
    as_json: bool,
) -> None:
    """Evaluate the policies and print their table; the arguments are those of the command.

    Raises:
        RequestError: a name is wrong, or one of ``outputs`` takes one policy alone.
        FlipperctlError: a policy failed on a scene; the other results are printed and written.
    """
    beside = standing(baseline, policies)
    references = controllers(passable, "--passable")
    made = method_scenes(words, policies, beside, suite)
    groups = parse(by, "--by", [config for config, _ in made.scenes])
    with ExitStack() as stack:
        written = EvaluationFiles(made.scenes, stack, **outputs, tell=print_note)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        progress = EvaluationProgress()
        result = evaluate(
            made.scenes,
            references=references,
            progress=progress,
            record=outputs["record"] is not None,
            stop=stop,
            store=written.store,
            names=made.names,
            plan=progress.plan,
        )
        if baseline != "none":
            result = with_best_known(result, made.scenes, written.store)
        result = grouped(result, groups)
        title = ", ".join(dict.fromkeys(entrant.method for entrant in policies))
        if suite:
            title = f"suite {suite.name}: {title}"
        try:
            print_result(result, None if as_json else title)
        finally:  # files are written even if the pipe is closed
            written.write(result)
        written.draw(result, stop, progress)
