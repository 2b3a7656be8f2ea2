"""The output of a training: its progress, its best validation, and follow-up commands.

In: a training or a finished run. Out: lines on stderr.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from flipperctl.config import TrainConfig
from flipperctl.evaluation.regret import final_regret
from flipperctl.process.session import command
from flipperctl.rollout.collect import Usage
from flipperctl.terminal.progress import TrainingProgress, success_text
from flipperctl.terminal.streams import print_note, print_notices
from flipperctl.training.run import Finished, Reports, check_device
from flipperctl.views import regret, summary


def reports() -> Reports:
    """Return callbacks that show a training on stderr and judge its best policy."""
    return Reports([TrainingProgress], print_note, print_note, final_regret)


def check_resumed(config: TrainConfig) -> None:
    """Refuse what a resumed run cannot use, and print the notices of its configuration."""
    check_device(config)
    print_notices(config)


def print_best(run: Finished) -> None:
    """Print the best validation of a newly trained run, its return, and the commands to use it."""
    if not run.trained:
        return
    best, measured = run.summary["best"], run.summary.get("regret")
    longer = f"train.decisions={2 * run.summary['decisions']}"
    # Lines that only some trainings have
    usage = run.summary["usage"]
    waits = _usage_line(Usage(**usage)) if usage else ""
    again = f"Longer:   {command('train', '--resume', run.directory, longer)}\n"
    print_note(
        f"\nTrained {run.summary['decisions']} decisions in {run.summary['seconds']:.0f} s.\n"
        f"Best validation, at decision {best['decision']}: {success_text(best)}, "
        f"return {best['mean_return']:.2f}.\n"
        f"{waits}{_risk_line(best)}{regret.line(measured)}"
        f"{again if regret.falls_short(measured) else ''}"
        f"Watch:    {command('watch', run.directory)}\n"
        f"Evaluate: {command('eval', run.directory)}\n"
        f"Export:   {command('export', 'onnx', run.directory)}"
    )


def _usage_line(usage: Usage) -> str:
    """Return a line about how busy learner and workers were."""
    workers = "the worker" if usage.workers == 1 else f"the {usage.workers} workers"
    busy = f"Busy: the learner {100 * (1 - usage.learner_idle):.0f} % of its time, {workers} "
    advice = usage.advice()
    return f"{busy}{100 * (1 - usage.workers_idle):.0f} %{advice and f'; {advice}'}.\n"


def _risk_line(validation: Mapping[str, Any]) -> str:
    """Return a line about the policy's risk, if it learnt one."""
    start = "risk_"
    measured = {n.removeprefix(start): v for n, v in validation.items() if n.startswith(start)}
    return f"Its risk, there: {summary.risk_text(measured)}.\n" if "threshold" in measured else ""
