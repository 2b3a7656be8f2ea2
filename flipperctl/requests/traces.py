"""Chosen episodes of an evaluation, which are played once more and stored as traces.

In: the result of an evaluation and its document. Out: ``traces.npz`` with the first episode of each
scene, the most telling one and the first failures, of every policy and baseline; pictures are drawn
from the traces.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.errors import FlipperctlError, InterruptedRunError, RequestError
from flipperctl.evaluation.evaluate import Played, Result
from flipperctl.evaluation.names import names
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.play import EpisodeRunner, Progress
from flipperctl.evaluation.replay import risks
from flipperctl.evaluation.rows import DIGEST, Row, reached, telling
from flipperctl.rollout.trace import Trace, read, write
from flipperctl.text.messages import counted
from flipperctl.views.summary import Document, named

FAILURES = 2
"""Largest number of failures of a method on a scene that are traced [-]."""
MOST = 200
"""Largest number of traces of an evaluation; failures come last [-]."""
_Key = tuple[str, str, int, int, str]


@dataclass(frozen=True)
class Chosen:
    """An episode to trace."""

    entry: Entry = field(repr=False)
    row: Row
    policy: str
    """Name of the policy, as in tables."""
    scene: str
    """Name of the scene, as in tables."""

    @property
    def key(self) -> _Key:
        """What is equal for equal episodes."""
        row = self.row
        who = self.policy, self.entry.conditions.hash
        return *who, row["seed"], row["episode"], row.get(DIGEST, "")


def choose(result: Result, document: Document) -> list[Chosen]:
    """Return the episodes of a result to trace: first ones, the most telling ones, failures."""
    first: dict[_Key, Chosen] = {}
    shown: dict[_Key, Chosen] = {}
    failed: dict[_Key, Chosen] = {}
    # All policies of a scene have one telling episode.
    played_on: dict[Any, list[Row]] = {}
    for item in result.played:
        played_on.setdefault(item.entry.ground, []).extend(item.episodes)
    best = {
        ground: telling(
            (row["episode"], reached(row), row["pitch_variation_100hz"]) for row in rows
        )
        for ground, rows in played_on.items()
    }

    failures = Counter[tuple[str, str]]()  # by scene and method, all its seeds together

    def add(played: Played, scene: str, method: str, seed: str = "") -> None:
        if played.entry.stored:  # another evaluation's policy, which may not be here
            return
        fails = played.episodes.failed[: FAILURES - failures[scene, method]]
        failures[scene, method] += len(fails)
        # An episode is chosen once.
        for choice, rows in (
            (first, played.episodes[:1]),
            (shown, played.episodes.where(lambda row: row["episode"] == best[played.entry.ground])),
            (failed, fails),
        ):
            episodes = [Chosen(played.entry, row, method + seed, scene) for row in rows]
            choice.update({c.key: c for c in episodes if c.key not in first | shown})

    # Baselines after the policy that they are compared with
    scenes = named(document)
    called = names([scene.get("method") or scene["controller"] for _, scene in scenes])
    for (scene, summary), item in zip(scenes, result.rows, strict=True):
        seed = f", seed {summary['training_seed']}" if "training_seed" in summary else ""
        add(item, scene, called[summary.get("method") or summary["controller"]], seed)
        for other in [] if result.plan.has_methods else result.baselines(item):
            add(other, scene, other.entry.label)
    return [*first.values(), *shown.values(), *failed.values()][:MOST]


class Traces:
    """The traces of an evaluation; traces of an earlier command are not played again."""

    def __init__(self, file: Path, episodes: Sequence[Chosen], tell: Callable[[str], None]) -> None:
        """Read the traces that ``file`` has; ``tell`` is called with a line if it is damaged."""
        self._file, self._chosen = file, episodes
        self._found: dict[_Key, Trace] = {}
        try:
            earlier = {
                (t.policy, t.conditions, t.seed, t.episode, t.digest): t
                for t in (read(file) if file.exists() else ())
            }
        except RequestError as error:
            tell(f"{error}; its episodes are played again")
            return
        # Traces of equal episodes are taken over, under the name that the scene has now.
        for item in episodes:
            if item.key in earlier:
                self._found[item.key] = replace(earlier[item.key], scene=item.scene)

    def write(self, file: Path) -> None:
        """Write the traces, in the order in which they were chosen, if there are any."""
        if self._found:
            write(file, [self._found[c.key] for c in self._chosen if c.key in self._found])

    def record(self, progress: Progress, stop: Callable[[], bool]) -> None:
        """Play the episodes that lack a trace, and write the file.

        A policy that fails does not affect the others. After a stop, those that were played are
        written.

        Raises:
            FlipperctlError: an episode cannot be played, or there was a stop.
        """
        missing = [item for item in self._chosen if item.key not in self._found]
        failed: list[FlipperctlError] = []
        # The episodes of an entry share an environment and a policy.
        groups: dict[int, list[Chosen]] = {}
        for item in missing:
            groups.setdefault(id(item.entry), []).append(item)
        for episodes in groups.values():
            try:
                self._play(episodes, progress, stop)
            except FlipperctlError as error:
                failed.append(error)
        if missing:
            self.write(self._file)
        # What a stop left out is said first, since it explains the rest.
        if stop() and (left := sum(item.key not in self._found for item in missing)):
            raise InterruptedRunError(
                f"interrupted: {self._file} lacks {left} of {counted(len(missing), 'episode')}"
            )
        if failed:
            more = f"; {len(failed) - 1} more failed" if len(failed) > 1 else ""
            raise type(failed[0])(f"{failed[0]}{more}")

    def _play(
        self, episodes: Sequence[Chosen], progress: Progress, stop: Callable[[], bool]
    ) -> None:
        entry, runner, done = episodes[0].entry, None, 0
        with progress(f"{entry.terrain}, {episodes[0].policy}, traces", len(episodes)) as report:

            def search(fraction: float) -> None:
                report(done + fraction)

            for done, item in enumerate(episodes):
                if stop():
                    return
                seed = entry.config.eval.seed
                runner = runner or EpisodeRunner(entry.config, entry.source, seed, search)
                transitions, profile = runner.transitions(item.row["episode"])
                # The digest tells later whether it is the episode of the row.
                policy, conditions, seed, episode, digest = item.key
                self._found[item.key] = Trace.of(
                    transitions,
                    profile,
                    policy=policy,
                    scene=item.scene,
                    episode=episode,
                    seed=seed,
                    conditions=conditions,
                    digest=digest,
                    risk=np.array(risks(item.row) or ()),
                )
                report(done + 1)

    def draw(self, file: Path, entry: Entry) -> None:
        """Draw a picture of the first episode of an entry, if it has a trace."""
        from flipperctl.figures.episode import episode_figure
        from flipperctl.figures.figure import save

        first = next((item.key for item in self._chosen if item.entry is entry), None)
        if first is not None and (trace := self._found.get(first)) is not None:
            save(episode_figure(trace), file, title(trace))


def title(trace: Trace) -> str:
    """Return one line about an episode, for a picture."""
    return f"{trace.policy} on {trace.scene}: {trace.outcome}"
