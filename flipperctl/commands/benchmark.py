"""``flipperctl benchmark``: play the frozen scenes, score methods, and verify result files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.terminal.streams import print_note, show

if TYPE_CHECKING:
    from flipperctl.evaluation import benchmark as frozen
    from flipperctl.evaluation.evaluate import Result
    from flipperctl.evaluation.plan import Entry, NamedPolicy


def benchmark(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="POLICY... [eval.KEY=VALUE]", help="Policies, as in eval."),
    ] = None,
    version: Annotated[str, typer.Option(metavar="NAME", help="Version of the benchmark.")] = "1",
    edition: Annotated[
        str, typer.Option(metavar="SALT", help="Draw other episodes than the public ones.")
    ] = "",
    track: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Play this track alone; repeatable.")
    ] = None,
    verify: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Play a part of a result file again.")
    ] = None,
    share: Annotated[
        float,
        typer.Option(min=0, max=1, metavar="X", help="Share of the episodes to verify."),
    ] = 0.05,
    jobs: options.Jobs = None,
    output: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of result files and episodes.")
    ] = Path("benchmarked"),
    as_json: options.AsJson = False,
) -> None:
    """Play the benchmark, and write a result file that others can verify.

    Each scene has a rule whose mean cost is 1: the pitch variation of a crossing, or the scene's
    fixed price for a failure. A score is the mean over a track's scenes; below 1 is better. The
    training seeds of a sweep are one method. --edition plays episodes that no repository knows: a
    result file holds a hash of the word alone.

    Repeat an interrupted command to resume it. --verify checks that a file is as it was written,
    and plays a share of its episodes again, bit for bit; --share 1 plays all.

    [bold]Examples[/]

      flipperctl benchmark generalist geometric --jobs 2

      flipperctl benchmark runs/sweep --track plane --output judged

      flipperctl benchmark okada --edition "a word that the judge keeps"

      flipperctl benchmark --verify benchmarked/generalist.json
    """
    from flipperctl.config.words import with_flags
    from flipperctl.evaluation import benchmark as frozen
    from flipperctl.evaluation.plan import entrants, refuse_beside, split_policies
    from flipperctl.policies.source import load_policy
    from flipperctl.text.files import write_bytes
    from flipperctl.text.show import console, print_table
    from flipperctl.views.benchmark import document, table

    names, settings = split_policies(words)
    settings = with_flags(settings, jobs=jobs)
    for word in settings:
        if not word.startswith(("eval.jobs=", "eval.ray=", "eval.cell=")):
            raise RequestError(
                f"{word}: the scenes of a benchmark are fixed; eval.jobs and eval.ray are allowed"
            )
    suite = frozen.find_benchmark(version)

    # A file is verified by its own tracks and policies, unless these lie elsewhere by now.
    if verify is not None:
        refuse_beside("--verify", {"track": track})
        stated = frozen.read_result(verify)
        stated.check(verify, suite)
        if stated.edition != frozen.edition(edition):
            raise RequestError(f"{verify}: its episodes are of another edition; give its --edition")
        policies = entrants(names or [p.label for p in stated.policies], print_note)
        sections = suite.sections({part.track: None for part in stated.scenes}, edition)
        _verify(verify, stated, _planned(policies, sections, settings), share)
        return

    # Whatever the folder lacks is played.
    if not names:
        raise RequestError("name a policy, as in: flipperctl benchmark generalist")
    policies = entrants(names, print_note)
    tracks = track or suite.tracks_for(load_policy(p.run or p.controller).robot() for p in policies)
    sections = suite.sections(tracks, edition)
    entries = _planned(policies, sections, settings)
    results = frozen.results_of(suite, edition, sections, _play(entries, output))
    tables = [document(result, frozen.scores(result, suite)) for result in results]
    for result in results:
        file = output / (re.sub(r"[^\w.=,+-]+", "_", result.method).strip("_.") + ".json")
        write_bytes(file, (result.model_dump_json() + "\n").encode())
        print_note(f"saved to {file}")
    show(
        {"benchmark": version, "methods": tables},
        lambda: print_table(table(tables), console()),
        as_json=as_json,
    )


def _planned(
    policies: Sequence[NamedPolicy], sections: Sequence[frozen.Section], settings: Sequence[str]
) -> list[Entry]:
    """Return an entry for each policy on each scene, and one for the scene's rule."""
    from flipperctl.evaluation.plan import NamedPolicy
    from flipperctl.requests.plan import entries_of
    from flipperctl.requests.text import from_words

    planned: list[Entry] = []
    for section in sections:
        named = section.label, from_words([*section.words, *settings])
        (rule,) = entries_of([NamedPolicy(section.scene.strongest)], [named], print_note)
        for entry in entries_of(policies, [named], print_note):
            if entry.ground != rule.ground:
                raise RequestError(
                    f"{entry.named}: it brings ground or a robot of its own to {section.label}; "
                    "a benchmark's scenes are equal for all"
                )
            planned.append(entry)
        planned.append(replace(rule, is_baseline=True))
    return planned


def _play(entries: Sequence[Entry], output: Path) -> Result:
    """Play the episodes that the folder lacks; return all, or raise what stopped it."""
    from flipperctl.checkpoint.results import hold
    from flipperctl.evaluation.evaluate import evaluate
    from flipperctl.evaluation.plan import Plan
    from flipperctl.evaluation.store import FOLDER, FolderStore
    from flipperctl.process.session import interrupts
    from flipperctl.terminal.progress import EvaluationProgress
    from flipperctl.text.files import make_folder

    progress = EvaluationProgress()
    with (
        hold(make_folder(output), "benchmark", "in use for a benchmark"),
        interrupts("finishing the episode; Ctrl-C again stops at once") as stop,
    ):
        store = FolderStore(output / FOLDER, print_note)
        result = evaluate(
            Plan(tuple(entries)),
            progress=progress,
            explain=False,
            stop=stop,
            store=store,
            planned=progress.plan,
        )
    if (error := result.error()) is not None:
        raise error
    if result.interruption is not None:
        raise InterruptedRunError(f"{result.interruption.text}; repeat the command to resume")
    return result


def _verify(
    file: Path, stated: frozen.BenchmarkResult, entries: Sequence[Entry], share: float
) -> None:
    """Play a share of a file's episodes again, and say that all are equal.

    Raises:
        FlipperctlError: an episode, or the content of a policy, differs.
    """
    import numpy as np

    from flipperctl.evaluation import benchmark as frozen
    from flipperctl.evaluation.play import Player
    from flipperctl.evaluation.store import versions_here
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.text.messages import counted

    # Other versions may play other episodes, which is no fault of the file.
    engines = {entry.config.sim.plugin_name: entry.config for entry in entries}
    here = {n: v for config in engines.values() for n, v in versions_here(config).items()}
    if others := [f"{n} {v}" for n, v in stated.versions.items() if here.get(n) != v]:
        print_note(f"{file}: it was played with {', '.join(others)}; episodes may differ here")
    count = 0
    with Player(None, episodes_progress) as player:
        played_by: dict[tuple[str, str], Entry] = {}
        for entry in entries:
            digest = "" if entry.is_baseline else player.identity(entry.source).digest
            played_by[entry.scene, digest] = entry
        for part, indices in frozen.sample(stated, share, np.random.default_rng()):
            label = f"{part.track}: {part.scene}"
            digests = [*(policy.digest for policy in stated.policies), ""]  # the rule comes last
            for digest, played in zip(digests, (*part.policies, part.rule), strict=True):
                if (label, digest) not in played_by:
                    raise RequestError(
                        f"{file}: a policy that was played is not among those of this content; "
                        "name its file, as in: flipperctl benchmark FILE --verify RESULT"
                    )
                entry = played_by[label, digest]
                rows = player.play(entry.config, entry.source, f"{label}, {entry.named}", indices)
                for index, row in zip(indices, rows, strict=True):
                    if text := frozen.difference(played, index, row):
                        raise FlipperctlError(
                            f"{file}: {label}, {entry.named}, episode {index} differs: {text}"
                        )
                    count += 1
    print_note(f"{file}: {counted(count, 'episode')} are equal, bit for bit")
