"""Read what ``eval --output`` wrote for several methods and training seeds.

In: folders with ``episodes.csv``, or folders of such folders, one for each training seed. Out: the
methods with the episodes that all of them played.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import Outcome
from flipperctl.api.plugin import registered_names
from flipperctl.env.metrics import RENAMED, with_both_names
from flipperctl.errors import RequestError
from flipperctl.evaluation.plan import is_best_known
from flipperctl.evaluation.seeds import SeedSamples
from flipperctl.text.files import CsvRow, read_csv

FILE, SUMMARY = "episodes.csv", "summary.json"
_KEYS = ("scene", "controller", "conditions_hash", "seed", "outcome")
_RENAMED = {**RENAMED, "policy": "policy_hash", "training": "training_hash"}
"""New names of columns by those of version 0.3."""

Episodes = dict[str, dict[str, tuple[float, bool]]]
"""Of one policy: measure and whether the finish was reached, by scene and the episode's seed."""


def read_document(folder: Path) -> dict[str, Any]:
    """Return the document that ``eval --output`` wrote into a folder.

    Raises:
        RequestError: it cannot be read, or is damaged.
    """
    file = folder / SUMMARY
    try:
        text = file.read_text(encoding="utf-8")
        document: dict[str, Any] = json.loads(text, object_hook=with_both_names)
    except OSError as error:
        raise RequestError(
            f"{file}: it cannot be read ({error.strerror}); a folder of flipperctl eval --output "
            "is allowed"
        ) from error
    except ValueError as error:
        raise RequestError(f"{file}: it is damaged: {error}") from error
    return document


@dataclass(frozen=True)
class _Run:
    """The episodes of one policy of a folder."""

    folder: Path
    """The first of its folders."""
    method: str
    """Its method, if the folder has several training seeds of it; else empty."""
    is_rule: bool
    episodes: Episodes
    digests: frozenset[str]
    """Digests of its weights or settings; none in a table of before version 0.3."""
    training_seed: str
    """Seed of its training; empty if it is unknown, or for a rule."""
    training: str
    """Digest of the settings of its training; empty for a rule or an exported file."""

    def is_of(self, other: _Run) -> bool:
        """Return whether another run is of the same policy; without digests, by its episodes."""
        if self.digests and other.digests:
            return not self.digests.isdisjoint(other.digests)
        return self.episodes == other.episodes

    def differs(self, other: _Run) -> bool:
        """Return whether another folder's run was trained with other settings, seeds apart."""
        return self.folder != other.folder and self.training != other.training

    def contradicts(self, other: _Run) -> bool:
        """Return whether the results of both differ on an episode that both played."""
        return any(
            other.episodes[scene].get(seed, result) != result
            for scene in self.episodes.keys() & other.episodes.keys()
            for seed, result in self.episodes[scene].items()
        )

    def joined(self, other: _Run) -> _Run:
        """Return the episodes of both runs of the same policy."""
        scenes = dict.fromkeys([*self.episodes, *other.episodes])
        episodes = {s: {**self.episodes.get(s, {}), **other.episodes.get(s, {})} for s in scenes}
        return replace(self, episodes=episodes, digests=self.digests | other.digests)


def _policies(folder: Path, measure: str) -> dict[str, _Run]:
    """Return each policy of a folder by label, the evaluated one before its baselines."""
    path, rows = folder / FILE, dict[str, list[CsvRow]]()
    for row in read_csv(path, (*_KEYS, measure), _RENAMED):
        if not is_best_known(row["controller"]):  # it stands only where it beats all others
            rows.setdefault(row["controller"], []).append(row)
    if not rows:
        raise RequestError(f"{path}: there is no episode in it")
    methods = {label: policy_rows[0].get("method", "") for label, policy_rows in rows.items()}
    counts = Counter(methods.values())
    return {
        label: _policy(folder, methods[label] if counts[methods[label]] > 1 else "", rows, measure)
        for label, rows in rows.items()
    }


def _policy(folder: Path, method: str, rows: Sequence[CsvRow], measure: str) -> _Run:
    """Return the policy of a label, whose rows these are."""
    episodes: Episodes = {}
    label, digests = (
        rows[0]["controller"],
        {row["policy_hash"] for row in rows if "policy_hash" in row},
    )
    for row in rows:
        scene = f"{row['scene']} {row['conditions_hash']}"
        value = row.number(measure), row["outcome"] == Outcome.REACHED
        if not np.isfinite(value[0]):
            raise row.refusal(measure, "a finite number is allowed")
        if episodes.setdefault(scene, {}).setdefault(row["seed"], value) != value:
            raise RequestError(
                f"{row.where}: {label} has several results on {scene}, seed {row['seed']}, as with "
                "several of its settings; a folder of eval --output for each of them, named as in "
                "METHOD=DIR, is allowed"
            )
    # A rule has no training, and is no exported file either.
    seed, training = (rows[0].get(name, "") for name in ("training_seed", "training_hash"))
    untrained = bool(digests) and not training and not Path(label).suffix
    is_rule = untrained or label in registered_names("controller")
    return _Run(folder, method, is_rule, episodes, frozenset(digests), seed, training)


@dataclass(frozen=True)
class Stored:
    """Methods on the episodes that all of their training seeds played."""

    methods: tuple[SeedSamples, ...]
    episodes: Mapping[str, int]
    """Number of shared episodes by scene."""
    notices: tuple[str, ...]
    """What was left out, in sentences."""


def named_path(word: str) -> tuple[str, Path]:
    """Return the name, empty without one, and the path of ``DIR`` or ``METHOD=DIR``."""
    name, equals, path = word.partition("=")
    if not equals or Path(word).exists():
        return "", Path(word)
    if not name or not path:
        raise RequestError(f"{word}: METHOD=DIR or DIR is allowed")
    return name, Path(path)


def read(words: Sequence[str], measure: str) -> Stored:
    """Read the methods of ``DIR`` or ``METHOD=DIR``; ``measure`` is the column of the score.

    A folder with ``episodes.csv`` is one training seed of a method, which has the name of its
    policy unless there is a ``METHOD``. A folder whose subfolders have such a file is one method
    with a training seed in each. An evaluation of a sweep has all the seeds of its methods.
    Baselines are methods by their own name. A policy that was evaluated several times counts once,
    with the episodes of all its folders.

    Raises:
        RequestError: a folder has no results, or a file is damaged or lacks the measure. Or two
            results of a policy contradict each other, a rule stands among training seeds, or no
            episode was played by all.
    """
    reader, seen = _Reader(measure), set[Path]()
    for word in words:
        name, path = named_path(word)

        # One training seed, or a folder with one in each subfolder
        folder = Path(path)
        below = not (folder / FILE).is_file()
        folders = sorted(file.parent for file in folder.glob(f"*/{FILE}")) if below else [folder]
        if not folders:
            first = ""
            if (folder / "checkpoints").is_dir():
                first = f"; this is a training: flipperctl eval {folder} --output DIR"
            raise RequestError(
                f"{folder}: there is no {FILE}, nor one in a folder below it; a folder of "
                f"flipperctl eval --output is allowed{first}"
            )

        # Each folder once, however it is named
        for entry in folders:
            if (place := entry.resolve()) in seen:
                reader.notices.append(f"{entry} is named twice and counts once")
                continue
            seen.add(place)
            reader.read(entry, name or (folder.resolve().name if below else None), is_seed=below)
    return reader.shared()


class _Reader:
    """The policies of the folders that were read so far."""

    def __init__(self, measure: str) -> None:
        self._measure = measure
        self._runs: dict[str, list[_Run]] = {}
        """By method."""
        self._rules: set[str] = set()
        """Methods that count once if their episodes are equal."""
        self._untrained: set[str] = set()
        """Methods without a training."""
        self.notices: list[str] = []

    def read(self, folder: Path, name: str | None, *, is_seed: bool) -> None:
        """Add the policies of a folder; ``name`` is the method of its first one, if it has one.

        ``is_seed``: whether the folder is of one training seed of a method.
        """
        policies = _policies(folder, self._measure)
        first, *_ = policies.values()
        # Each policy of the folder belongs to a method: the named one, a trained one, or its own.
        for label, run in policies.items():
            leads = run is first or bool(run.method and run.method == first.method)
            method = name if name and leads else run.method or label
            # Sweeps of one folder tell their methods apart, those of two may use one name twice.
            if method == run.method and any(run.differs(k) for k in self._runs.get(method, ())):
                method = f"{folder}/{method}"
            mixed = method in self._runs and run.is_rule != (method in self._untrained)
            if is_seed and run is first and mixed:
                rule = label if run.is_rule else "of another folder"
                raise RequestError(
                    f"{folder}: {method} has a rule, {rule}, beside trained policies; a rule is no "
                    "training seed"
                )
            if run.is_rule:
                self._untrained.add(method)
            if run.is_rule or not (leads or run.method):
                self._rules.add(method)
            # A policy that several folders have counts once, and must have equal results in all.
            known = self._runs.setdefault(method, [])
            same = [at for at, other in enumerate(known) if run.is_of(other)]
            if any(
                run.contradicts(known[at]) for at in (range(len(known)) if run.is_rule else same)
            ):
                raise RequestError(
                    f"{folder}: {label} has other results there than in another folder, as with "
                    "other settings; METHOD=DIR gives each a name of its own"
                )
            if not same:
                known.append(run)
                continue
            known[same[0]] = known[same[0]].joined(run)
            if leads:
                self.notices.append(f"{folder} has a policy of another folder, which counts once")

    def shared(self) -> Stored:
        """Return the methods on the scenes and episodes that every run has."""
        for method, known in self._runs.items():
            self.notices += _doubts(method, known)
        # Only episodes that every run has can be compared.
        runs = [run for known in self._runs.values() for run in known]
        shared: dict[str, list[str]] = {}
        for scene in dict.fromkeys(scene for run in runs for scene in run.episodes):
            seeds = [set(run.episodes.get(scene, ())) for run in runs]
            common = set.intersection(*seeds)
            if common:
                shared[scene] = [seed for seed in runs[0].episodes[scene] if seed in common]
            counts = list(map(len, seeds))
            if (most := max(counts)) > len(common):
                fewest = runs[counts.index(min(counts))].folder
                self.notices.append(
                    f"{scene}: {len(common)} of up to {most} episodes were played by all; "
                    f"{fewest} has {min(counts)}"
                )
        if not shared:
            text = "no episode was played by all methods and seeds"
            raise RequestError(f"{text}: {_unlike(runs)}")
        # Arrays of the shared episodes; a rule counts once, however often it was evaluated.
        names = _short(list(shared))
        methods = []
        for method, known in self._runs.items():
            played = [  # (S, E, 2) by scene
                {names[k]: [run.episodes[k][seed] for seed in seeds] for k, seeds in shared.items()}
                for run in known
            ]
            if method in self._rules:
                played = [row for at, row in enumerate(played) if row not in played[:at]]
            pairs = {name: np.array([run[name] for run in played]) for name in played[0]}
            values = {name: outcomes[..., 0].copy() for name, outcomes in pairs.items()}
            reached = {name: outcomes[..., 1] > 0 for name, outcomes in pairs.items()}
            methods.append(
                SeedSamples(method, values, reached, trained=method not in self._untrained)
            )
        episodes = {names[scene]: len(seeds) for scene, seeds in shared.items()}
        return Stored(tuple(methods), episodes, tuple(self.notices))


def _doubts(method: str, runs: Sequence[_Run]) -> Iterator[str]:
    """Yield a notice if two policies of a method have one training seed, or other settings."""
    seeds = Counter(run.training_seed for run in runs if run.training_seed)
    seed, count = max(seeds.items(), key=lambda item: item[1], default=("", 0))
    if count > 1:
        yield (
            f"{method}: {seeds.total()} policies, but training seed {seed} counts {count} times; "
            "trainings of one method differ in their seeds"
        )
    if len({run.training for run in runs if run.training}) > 1:
        yield (
            f"{method}: its policies were trained with different settings, as the column "
            f"training_hash of {FILE} says; trainings of one method differ in their seeds alone, "
            "and METHOD=DIR gives others a name of their own"
        )


def _unlike(runs: Sequence[_Run]) -> str:
    """Return in which folders others were played."""
    scenes: dict[str, dict[str, None]] = {}
    for run in runs:
        scenes.setdefault(", ".join(run.episodes), {})[str(run.folder)] = None
    if len(scenes) == 1:
        return "their conditions are equal, but not their episodes, as with another --seed"
    each = "; ".join(f"{', '.join(folders)}: {names}" for names, folders in scenes.items())
    return f"{each}; the same terrain=… and conditions=… for all are allowed"


def _short(scenes: Sequence[str]) -> dict[str, str]:
    """Return the name of each scene: its terrain, and the hash too if a terrain has several."""
    terrains = [scene.rpartition(" ")[0] for scene in scenes]
    return {
        scene: terrain if terrains.count(terrain) == 1 else scene
        for scene, terrain in zip(scenes, terrains, strict=True)
    }
