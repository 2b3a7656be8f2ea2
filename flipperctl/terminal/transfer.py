"""The output of ``flipperctl transfer``: a table of scenes, and failures in the other engine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from flipperctl.evaluation.conditions import scene_names
from flipperctl.evaluation.results import Summary
from flipperctl.evaluation.tables import interval_text
from flipperctl.runs.follow_up import command
from flipperctl.studies.transfer import SensedResult, TransferResult
from flipperctl.terminal.conditions import condition_lines
from flipperctl.terminal.console import console, print_lines
from flipperctl.terminal.evaluation import gap_cells
from flipperctl.terminal.pitch_variation import HEADING
from flipperctl.terminal.tables import Table


def print_transfer(
    found: list[TransferResult], policy: list[str], overrides: Sequence[str]
) -> None:
    """Print a row for each scene, and below them a line for each failure.

    ``policy`` and ``overrides`` are words of the user's command.
    """
    out = console()
    names = scene_names([(one.terrain, one.conditions) for one in found])
    named = list(zip(names, found, strict=True))
    _table(named).print(out)
    lines = condition_lines((one.terrain, one.seed, one.conditions) for one in found)
    print_lines(out, (*lines, *_failures(named, policy, overrides)))


def _table(named: list[tuple[str, TransferResult]]) -> Table:
    one = named[0][1]
    first, second = one.engines
    title = f"{one.controller} in {second} against {first}, the same episodes"
    sensors = sorted({found.sensor for _, one in named if (found := one.sensed)})
    sensing = (
        *(f"success with {', '.join(sensors)}", "Δ success by sensing", "won, lost there"),
        *("p there (Holm)", f"Δ {HEADING} by sensing"),
    )
    headings = (
        *("terrain", "episodes", f"success in {first}", f"in {second}", "Δ success", "won, lost"),
        *("p (Holm)", "kept", HEADING, f"Δ {HEADING}", "Δ t_cost [s]"),
        *(sensing if sensors else ()),
        "failures",
    )
    table = Table(headings, title, words=["failures"])
    for name, one in named:
        table.add(
            name,
            str(one.other.episodes),
            f"{one.default.success_rate:.3f}",
            f"{one.other.success_rate:.3f}",
            *gap_cells(one.success_gap),
            "–" if one.kept is None else f"{one.kept:.1%}",
            " → ".join(_variation(summary) for summary in _steps(one)),
            interval_text(one.gap.pitch_variation_100hz, sign="+"),
            interval_text(one.gap.t_cost, 1, sign="+"),
            *(_sensing_cells(one.sensed) if sensors else ()),
            ", ".join(f"{cause} {count}" for cause, count in one.causes.items()) or "none",
        )
    return table


def _steps(one: TransferResult) -> list[Summary]:
    return [one.default, one.other, *([one.sensed.summary] if one.sensed else [])]


def _sensing_cells(found: SensedResult | None) -> list[str]:
    if found is None:
        return ["–"] * 5
    gap = found.gap
    variation = interval_text(gap.pitch_variation_100hz, sign="+")
    return [f"{found.summary.success_rate:.3f}", *gap_cells(gap.success), variation]


def _failures(
    named: list[tuple[str, TransferResult]], policy: list[str], overrides: Sequence[str]
) -> Iterator[str]:
    """Yield a line for each failure, and the command that replays it."""
    for name, one in named:
        for f in one.failures:
            yield (
                f"{name}, episode {f.episode}: {f.cause} ({f.outcome} after {f.time:.1f} s "
                f"at x {f.x:.2f} m, pitch {f.pitch:.2f}, roll {f.roll:.2f}, yaw {f.yaw:.2f} rad, "
                f"{f.side:.2f} m aside; {f.default_outcome} in {one.engines[0]})"
            )
            again = [*policy, *_of_one(one, overrides)]
            seed = ["--seed", str(one.seed), "--only", str(f.episode)]
            yield f"  {command('transfer', *again, *seed)}"


def _of_one(one: TransferResult, overrides: Sequence[str]) -> Iterator[str]:
    """Yield the overrides that lead to one result alone, where lists of them led to several."""
    chosen = {"terrain": one.terrain, "conditions": one.conditions.name}
    for word in overrides:
        key, _, value = word.partition("=")
        if key in chosen and "," in value and not value.startswith("{"):
            yield f"{key}={chosen[key]}"
        elif key != "eval.seed":
            yield word


def _variation(summary: Summary) -> str:
    found = summary.pitch_variation_100hz
    return "–" if found is None else f"{found.mean:.2f}"
