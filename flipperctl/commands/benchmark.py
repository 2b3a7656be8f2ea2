"""``flipperctl benchmark``: play the frozen scenes, score methods, and verify result files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.terminal.streams import print_note, show

if TYPE_CHECKING:
    from flipperctl.evaluation import benchmark as frozen
    from flipperctl.evaluation.plan import Entry, NamedPolicy

Sections = dict[tuple[str, str], "frozen.Scene"]
"""Track and name of a scene → the scene."""


def benchmark(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="POLICY... [eval.KEY=VALUE]", help="Policies, as in eval."),
    ] = None,
    version: Annotated[
        str, typer.Option(metavar="NAME", help="Version of the benchmark [1].")
    ] = "1",
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
        typer.Option(min=0, max=1, metavar="X", help="Share of the episodes to verify [0.05]."),
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
    from flipperctl.evaluation.plan import entrants, split_policies
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
    stated = None if verify is None else frozen.read_result(verify)

    # A file to verify names its policies, unless they lie elsewhere by now.
    if verify is not None and stated is not None:
        stated.check(verify, version, suite)
        if stated.edition != frozen.edition(edition):
            raise RequestError(f"{verify}: its episodes are of another edition; give its --edition")
        names = names or [policy.label for policy in stated.policies]
    if not names:
        raise RequestError("name a policy, as in: flipperctl benchmark generalist")
    policies = entrants(names, print_note)
    chosen = _scenes(suite, track, stated)
    words_of = {
        key: [*_words(suite, version, key, chosen[key], edition), *settings] for key in chosen
    }
    entries = _planned(policies, chosen, words_of)

    # Either part of a file is played again, or everything that the folder lacks is played.
    if verify is not None and stated is not None:
        _verify(verify, stated, entries, share)
        return
    results = _play(suite, version, policies, chosen, entries, edition, output)
    tables = [document(result, frozen.scores(result, suite)) for result in results]
    for result in results:
        print_note(f"saved to {output / _file(result.method)}")
    show(
        {"benchmark": version, "methods": tables},
        lambda: print_table(table(tables), console()),
        as_json=as_json,
    )


def _scenes(
    suite: frozen.Benchmark, tracks: Sequence[str] | None, stated: frozen.BenchmarkResult | None
) -> Sections:
    """Return the scenes of the chosen tracks, or those of a result file."""
    from flipperctl.text.messages import close_match

    for name in tracks or ():
        if name not in suite.tracks:
            known = ", ".join(suite.tracks)
            hint = close_match(name, suite.tracks)
            raise RequestError(f"--track: there is no track {name!r}{hint}; known: {known}")
    every = {
        (name, scene): content
        for name, track in suite.tracks.items()
        for scene, content in track.scenes.items()
        if name in (tracks or suite.tracks)
    }
    if stated is None:
        return every
    return {key: every[key] for part in stated.scenes if (key := (part.track, part.scene)) in every}


def _words(
    suite: frozen.Benchmark, version: str, key: tuple[str, str], scene: frozen.Scene, salt: str
) -> list[str]:
    """Return the settings of a scene with the number and the seed of its episodes."""
    import shlex

    from flipperctl.evaluation import benchmark as frozen

    seed = frozen.scene_seed(version, salt, *key)
    episodes = suite.tracks[key[0]].episodes
    return [*shlex.split(scene.words), f"eval.seed={seed}", f"eval.episodes={episodes}"]


def _planned(
    policies: Sequence[NamedPolicy],
    chosen: Sections,
    words_of: dict[tuple[str, str], list[str]],
) -> list[Entry]:
    """Return an entry for each policy on each scene, and one for the scene's rule."""
    from flipperctl.evaluation.plan import Entry, NamedPolicy
    from flipperctl.requests.plan import entries_of
    from flipperctl.requests.text import from_words

    planned: list[Entry] = []
    for key, scene in chosen.items():
        section = ": ".join(key), from_words(words_of[key])
        (rule,) = entries_of([NamedPolicy(scene.strongest)], [section], print_note)
        for entry in entries_of(policies, [section], print_note):
            if entry.ground != rule.ground:
                raise RequestError(
                    f"{entry.named}: it brings ground or a robot of its own to {section[0]}; "
                    "a benchmark's scenes are equal for all"
                )
            planned.append(entry)
        planned.append(Entry(rule.config, rule.source, rule.scene, rule.method, is_baseline=True))
    return planned


def _play(
    suite: frozen.Benchmark,
    version: str,
    policies: Sequence[NamedPolicy],
    chosen: Sections,
    entries: Sequence[Entry],
    salt: str,
    output: Path,
) -> list[frozen.BenchmarkResult]:
    """Play what the folder lacks; write and return the result of each method."""
    from flipperctl.checkpoint.results import hold
    from flipperctl.evaluation import benchmark as frozen
    from flipperctl.evaluation.evaluate import evaluate
    from flipperctl.evaluation.plan import Plan
    from flipperctl.evaluation.store import FOLDER, FolderStore, versions_here
    from flipperctl.process.session import interrupts
    from flipperctl.terminal.progress import EvaluationProgress
    from flipperctl.text.files import make_folder, write_bytes

    with (
        hold(make_folder(output), "benchmark", "in use for a benchmark"),
        interrupts("finishing the episode; Ctrl-C again stops at once") as stop,
    ):
        store, progress = FolderStore(output / FOLDER, print_note), EvaluationProgress()
        result = evaluate(
            Plan(tuple(entries)),
            progress=progress,
            stop=stop,
            store=store,
            planned=progress.plan,
        )
        if (error := result.error()) is not None:
            raise error
        if result.interruption is not None:
            raise InterruptedRunError(f"{result.interruption.text}; repeat the command to resume")

        # A file for each method, of its policies' episodes and the rules'
        played = {(p.entry.scene, p.entry.named, p.entry.is_baseline): p for p in result.played}
        results = []
        for method in dict.fromkeys(policy.method for policy in policies):
            of_method = [e for e in entries if e.method == method and not e.is_baseline]
            named = list(dict.fromkeys(entry.named for entry in of_method))
            first = ": ".join(next(iter(chosen)))
            identities = [played[first, name, False].policy for name in named]
            scenes = []
            for key, scene in chosen.items():
                label = ": ".join(key)
                mine = [frozen.Played.of(played[label, name, False].episodes) for name in named]
                rule = frozen.Played.of(played[label, scene.strongest, True].episodes)
                scenes.append(
                    frozen.SceneResult(track=key[0], scene=key[1], policies=tuple(mine), rule=rule)
                )
            made = frozen.BenchmarkResult(
                benchmark=version,
                scenes_hash=suite.digest,
                edition=frozen.edition(salt),
                method=method,
                policies=tuple(
                    frozen.PolicyEntry(
                        label=identity.label,
                        digest=identity.digest,
                        training_seed=identity.training_seed,
                    )
                    for identity in identities
                    if identity is not None
                ),
                versions=versions_here(of_method[0].config),
                scenes=tuple(scenes),
            ).sealed()
            text = made.model_dump_json() + "\n"
            write_bytes(output / _file(method), text.encode())
            results.append(made)
        return results


def _file(method: str) -> str:
    """Return the name of a method's result file."""
    return re.sub(r"[^\w.=,+-]+", "_", method).strip("_.") + ".json"


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
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.text.messages import counted

    count = 0
    with Player(None, episodes_progress) as player:
        indices = frozen.sample(stated, share, np.random.default_rng())
        for part, chosen in zip(stated.scenes, indices, strict=True):
            label = f"{part.track}: {part.scene}"
            here = [entry for entry in entries if entry.scene == label]
            # The policies in the order of the file, then the rule
            for entry, played in zip(here, (*part.policies, part.rule), strict=True):
                _check_identity(file, stated, player.identity(entry.source).digest, entry)
                rows = player.play(entry.config, entry.source, f"{label}, {entry.named}", chosen)
                for index, row in zip(chosen, rows, strict=True):
                    if text := frozen.difference(played, index, row):
                        raise FlipperctlError(
                            f"{file}: {label}, {entry.named}, episode {index} differs: {text}"
                        )
                    count += 1
    print_note(f"{file}: {counted(count, 'episode')} are equal, bit for bit")


def _check_identity(file: Path, stated: frozen.BenchmarkResult, digest: str, entry: Entry) -> None:
    if not entry.is_baseline and digest not in [policy.digest for policy in stated.policies]:
        raise RequestError(
            f"{file}: {entry.label} has another content than the policy that was played; "
            "give the policy's own file, as in: flipperctl benchmark FILE --verify RESULT"
        )
